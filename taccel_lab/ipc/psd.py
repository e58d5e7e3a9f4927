# SPDX-License-Identifier: Apache-2.0
"""Projection of small symmetric matrices to the nearest positive semidefinite one.

Cyclic Jacobi rotations (Golub & Van Loan, Matrix Computations, section 8.5) for 3x3 up to 12x12:
accurate for any spectrum, no branches by multiplicity, fixed memory. Sizes are held in variables so
that Warp keeps the loops rolled; unrolled, a 12x12 would take minutes to compile.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from taccel_lab.ipc.matrix_types import mat55d, mat1212d

wp.set_module_options({"enable_backward": False})

_MAX_SWEEPS = wp.constant(16)


@wp.func
def _jacobi_project(matrix: Any, vectors: Any, size: wp.int32):
    """Clamp the negative eigenvalues of a symmetric matrix; `vectors` enters as the identity."""
    a = matrix
    q = vectors
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    sweep = int(0)
    rotated = int(1)
    while rotated > 0 and sweep < _MAX_SWEEPS:
        rotated = int(0)
        sweep += 1
        for i in range(size - 1):
            for j in range(i + 1, size):
                off = a[i, j]
                floor = wp.float64(1.0e-17) * (wp.abs(a[i, i]) + wp.abs(a[j, j]))
                if wp.abs(off) > floor:
                    rotated = int(1)
                    theta = (a[j, j] - a[i, i]) / (wp.float64(2.0) * off)
                    t = one / (wp.abs(theta) + wp.sqrt(theta * theta + one))
                    if theta < zero:
                        t = -t
                    c = one / wp.sqrt(t * t + one)
                    s = t * c
                    for k in range(size):
                        aki = a[k, i]
                        akj = a[k, j]
                        a[k, i] = c * aki - s * akj
                        a[k, j] = s * aki + c * akj
                    for k in range(size):
                        aik = a[i, k]
                        ajk = a[j, k]
                        a[i, k] = c * aik - s * ajk
                        a[j, k] = s * aik + c * ajk
                    for k in range(size):
                        qki = q[k, i]
                        qkj = q[k, j]
                        q[k, i] = c * qki - s * qkj
                        q[k, j] = s * qki + c * qkj
                    a[i, j] = zero
                    a[j, i] = zero
    result = matrix
    lowest = zero
    for k in range(size):
        lowest = wp.min(lowest, a[k, k])
    if lowest < zero:
        for i in range(size):
            for j in range(i + 1):
                total = zero
                for k in range(size):
                    total += q[i, k] * wp.max(a[k, k], zero) * q[j, k]
                result[i, j] = total
                result[j, i] = total
    return result


@wp.func
def project_psd_2x2(matrix: wp.mat22d) -> wp.mat22d:
    """Nearest positive semidefinite matrix of a symmetric 2x2 matrix, in closed form."""
    zero = wp.float64(0.0)
    half = wp.float64(0.5)
    mean = half * (matrix[0, 0] + matrix[1, 1])
    difference = half * (matrix[0, 0] - matrix[1, 1])
    radius = wp.sqrt(difference * difference + matrix[0, 1] * matrix[0, 1])
    if mean >= radius:
        return matrix
    top = mean + radius
    if top <= zero:
        return wp.mat22d(zero, zero, zero, zero)
    # Projector of the top eigenvalue: (A - low I) / (top - low) with low = mean - radius.
    scale = half * top / radius
    corner = scale * matrix[0, 1]
    return wp.mat22d(scale * (radius + difference), corner, corner, scale * (radius - difference))


@wp.func
def project_psd_3x3(matrix: wp.mat33d) -> wp.mat33d:
    """Nearest positive semidefinite matrix of a symmetric 3x3 matrix."""
    return _jacobi_project(matrix, wp.identity(n=3, dtype=wp.float64), 3)


@wp.func
def project_psd_5x5(matrix: mat55d) -> mat55d:
    """Nearest positive semidefinite matrix of a symmetric 5x5 matrix.

    Every contact comes by here, so the matrices are to stay in registers: rows (1, 4) and (2, 3)
    are rotated, which fixed indices name, then all rows move on by one. Five rounds meet all pairs
    (a round-robin tournament) and end in the order that they began in.
    """
    a = matrix
    q = wp.identity(n=5, dtype=wp.float64)
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    sweep = int(0)
    rotated = int(1)
    round_count = int(5)
    while rotated > 0 and sweep < _MAX_SWEEPS:
        rotated = int(0)
        sweep += 1
        for _round in range(round_count):
            for m in range(2):
                i = 1 + m
                j = 4 - m
                off = a[i, j]
                floor = wp.float64(1.0e-17) * (wp.abs(a[i, i]) + wp.abs(a[j, j]))
                if wp.abs(off) > floor:
                    rotated = int(1)
                    theta = (a[j, j] - a[i, i]) / (wp.float64(2.0) * off)
                    t = one / (wp.abs(theta) + wp.sqrt(theta * theta + one))
                    if theta < zero:
                        t = -t
                    c = one / wp.sqrt(t * t + one)
                    s = t * c
                    a[i, i] = a[i, i] - t * off
                    a[j, j] = a[j, j] + t * off
                    a[i, j] = zero
                    a[j, i] = zero
                    for k in range(5):
                        if k != i and k != j:
                            aki = a[k, i]
                            akj = a[k, j]
                            a[k, i] = c * aki - s * akj
                            a[k, j] = s * aki + c * akj
                            a[i, k] = a[k, i]
                            a[j, k] = a[k, j]
                        qki = q[k, i]
                        qkj = q[k, j]
                        q[k, i] = c * qki - s * qkj
                        q[k, j] = s * qki + c * qkj
            b = a
            r = q
            for i in range(5):
                for j in range(5):
                    a[(i + 1) % 5, (j + 1) % 5] = b[i, j]
                    q[i, (j + 1) % 5] = r[i, j]
    lowest = zero
    for k in range(5):
        lowest = wp.min(lowest, a[k, k])
    if lowest >= zero:
        return matrix
    scaled = q
    for k in range(5):
        for i in range(5):
            scaled[i, k] = q[i, k] * wp.max(a[k, k], zero)
    result = scaled * wp.transpose(q)
    return wp.float64(0.5) * (result + wp.transpose(result))


@wp.func
def project_psd_12x12(matrix: mat1212d) -> mat1212d:
    """Nearest positive semidefinite matrix of a symmetric 12x12 matrix.

    A reference: 5 kB of local memory a thread. Contacts use the 5x5 form of `pair_hessian`.
    """
    return _jacobi_project(matrix, wp.identity(n=12, dtype=wp.float64), 12)
