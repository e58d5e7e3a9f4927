# SPDX-License-Identifier: Apache-2.0
"""Projection of symmetric 5x5 matrices to the nearest positive semidefinite one.

Cyclic Jacobi rotations (Golub & Van Loan, Matrix Computations, section 8.5): accurate for any
spectrum, no branches by multiplicity, fixed memory.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.matrix_types import mat55d

wp.set_module_options({"enable_backward": False})

_MAX_SWEEPS = wp.constant(16)


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
