# SPDX-License-Identifier: Apache-2.0
"""Small matrices: types of stencils, tangents, eigenvalues, singular values.

Fixed-size FP64 matrix types of a contact stencil of four nodes (12 degrees of freedom).

Row and column `3 i + a` of a 12x12 matrix belongs to coordinate `a` of stencil node `i`; row `i` of
a 4x3 matrix is the 3-vector of node `i`.

Orthonormal tangents of a unit normal.

Householder form: the reflection that maps the z axis (or its negative, whichever is nearer) to the
normal maps x and y to tangents. The denominator 1 + |n_z| is at least 1, so no direction is
special; it is the choice of sign discussed by Duff et al. (2017), Building an Orthonormal Basis,
Revisited.

Eigenvalues and eigenvectors of symmetric 3x3 matrices.

Cyclic Jacobi rotations (Golub & Van Loan, Matrix Computations, section 8.5): orthonormal vectors
for any spectrum, equal eigenvalues included, and half the time of `wp.eig3`.

Singular values and rotations of 3x3 matrices, inverted and singular ones included.

One-sided Jacobi rotations [Demmel and Veselic 1992, Jacobi's method is more accurate than QR]: the
matrix itself is rotated, never F^T F, so small singular values keep their digits.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

mat23d = wp.types.matrix(shape=(2, 3), dtype=wp.float64)
mat43d = wp.types.matrix(shape=(4, 3), dtype=wp.float64)
mat1212d = wp.types.matrix(shape=(12, 12), dtype=wp.float64)


@wp.func
def tangent_basis(n: wp.vec3d) -> mat23d:
    """Rows t1, t2 with t1 x t2 = n for a unit vector n; orthonormal rows also for n = 0."""
    one = wp.float64(1.0)
    sign = wp.where(n[2] < wp.float64(0.0), -one, one)
    a = -one / (sign + n[2])
    b = n[0] * n[1] * a
    t1 = wp.vec3d(one + sign * n[0] * n[0] * a, sign * b, -sign * n[0])
    t2 = wp.vec3d(b, sign + n[1] * n[1] * a, -n[1])
    return wp.matrix_from_rows(t1, t2)


_MAX_SWEEPS = wp.constant(12)


@wp.func
def jacobi_rotation(a_pp: wp.float64, a_qq: wp.float64, a_pq: wp.float64) -> wp.vec2d:
    """Tangent and cosine of the rotation that makes a_pq vanish."""
    one = wp.float64(1.0)
    theta = (a_qq - a_pp) / (wp.float64(2.0) * a_pq)
    t = one / (wp.abs(theta) + wp.sqrt(theta * theta + one))
    if theta < wp.float64(0.0):
        t = -t
    return wp.vec2d(t, one / wp.sqrt(t * t + one))


@wp.func
def symmetric_eigen_3x3(matrix: wp.mat33d):
    """Eigenvalues, unordered, and the orthogonal matrix with the eigenvectors as columns."""
    a = matrix
    v = wp.identity(n=3, dtype=wp.float64)
    eps = wp.float64(1.0e-16)
    sweep = int(0)
    rotated = int(1)
    while rotated > 0 and sweep < _MAX_SWEEPS:
        rotated = int(0)
        sweep += 1
        for m in range(3):
            p = m
            q = (m + 1) % 3
            r = (m + 2) % 3
            a_pq = a[p, q]
            if wp.abs(a_pq) > eps * (wp.abs(a[p, p]) + wp.abs(a[q, q])):
                rotated = int(1)
                rotation = jacobi_rotation(a[p, p], a[q, q], a_pq)
                t = rotation[0]
                c = rotation[1]
                s = t * c
                a[p, p] = a[p, p] - t * a_pq
                a[q, q] = a[q, q] + t * a_pq
                a[p, q] = wp.float64(0.0)
                a[q, p] = wp.float64(0.0)
                a_rp = a[r, p]
                a_rq = a[r, q]
                a[r, p] = c * a_rp - s * a_rq
                a[p, r] = a[r, p]
                a[r, q] = s * a_rp + c * a_rq
                a[q, r] = a[r, q]
                for i in range(3):
                    v_ip = v[i, p]
                    v_iq = v[i, q]
                    v[i, p] = c * v_ip - s * v_iq
                    v[i, q] = s * v_ip + c * v_iq
    return wp.get_diag(a), v


@wp.func
def matrix_column(m: wp.mat33d, k: int) -> wp.vec3d:
    """Column k."""
    return wp.vec3d(m[0, k], m[1, k], m[2, k])


@wp.func
def unit_perpendicular(direction: wp.vec3d, unit: wp.vec3d) -> wp.vec3d:
    """Unit vector along the part of ``direction`` across ``unit``, which may be zero; any one where
    nothing is left."""
    across = direction - wp.dot(direction, unit) * unit
    length = wp.length(across)
    if length > wp.float64(1.0e-150):
        return across / length
    axis = wp.vec3d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0))
    if wp.abs(unit[0]) > wp.float64(0.6):
        axis = wp.vec3d(wp.float64(0.0), wp.float64(1.0), wp.float64(0.0))
    # Also right where ``unit`` is zero, which leaves every direction.
    return wp.normalize(axis - wp.dot(axis, unit) * unit)


@wp.func
def orthogonal_columns(matrix: wp.mat33d):
    """B and a rotation V with B = F V whose columns are orthogonal."""
    b = matrix
    v = wp.identity(n=3, dtype=wp.float64)
    sweep = int(0)
    rotated = int(1)
    while rotated > 0 and sweep < _MAX_SWEEPS:
        rotated = int(0)
        sweep += 1
        for m in range(3):
            p = m
            q = (m + 1) % 3
            b_p = matrix_column(b, p)
            b_q = matrix_column(b, q)
            pp = wp.dot(b_p, b_p)
            qq = wp.dot(b_q, b_q)
            pq = wp.dot(b_p, b_q)
            # Above the rounding of the product, below which it would turn for ever.
            if wp.abs(pq) > wp.float64(1.0e-15) * wp.sqrt(pp) * wp.sqrt(qq):
                rotated = int(1)
                rotation = jacobi_rotation(pp, qq, pq)
                c = rotation[1]
                s = rotation[0] * c
                for i in range(3):
                    b[i, p] = c * b_p[i] - s * b_q[i]
                    b[i, q] = s * b_p[i] + c * b_q[i]
                    v_ip = v[i, p]
                    v_iq = v[i, q]
                    v[i, p] = c * v_ip - s * v_iq
                    v[i, q] = s * v_ip + c * v_iq
    return b, v


@wp.func
def signed_svd_3x3(f: wp.mat33d):
    """F = U diag(s) V^T with rotations U and V (det = +1) and s unordered.

    The singular value of smallest size is negative where det F < 0 [Irving et al. 2004,
    Invertible Finite Elements], so that U, s and V are continuous through inversion.
    """
    b, v = orthogonal_columns(f)
    b_0 = matrix_column(b, 0)
    b_1 = matrix_column(b, 1)
    b_2 = matrix_column(b, 2)
    lengths = wp.vec3d(wp.dot(b_0, b_0), wp.dot(b_1, b_1), wp.dot(b_2, b_2))
    # k is the shortest column; i, j, k follow each other in a cycle, so u_k = u_i x u_j.
    k = int(0)
    if lengths[1] < lengths[k]:
        k = int(1)
    if lengths[2] < lengths[k]:
        k = int(2)
    b_i = matrix_column(b, (k + 1) % 3)
    b_j = matrix_column(b, (k + 2) % 3)
    zero = wp.vec3d()
    u_i = wp.vec3d()
    u_j = wp.vec3d()
    if wp.dot(b_i, b_i) >= wp.dot(b_j, b_j):
        u_i = unit_perpendicular(b_i, zero)
        u_j = unit_perpendicular(b_j, u_i)
    else:
        u_j = unit_perpendicular(b_j, zero)
        u_i = unit_perpendicular(b_i, u_j)
    u_k = wp.cross(u_i, u_j)
    u = wp.mat33d()
    s = wp.vec3d()
    for row in range(3):
        u[row, (k + 1) % 3] = u_i[row]
        u[row, (k + 2) % 3] = u_j[row]
        u[row, k] = u_k[row]
    s[(k + 1) % 3] = wp.dot(u_i, b_i)
    s[(k + 2) % 3] = wp.dot(u_j, b_j)
    s[k] = wp.dot(u_k, matrix_column(b, k))
    return u, s, v
