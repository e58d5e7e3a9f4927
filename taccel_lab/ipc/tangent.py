# SPDX-License-Identifier: Apache-2.0
"""Orthonormal tangents of a unit normal.

Householder form: the reflection that maps the z axis (or its negative, whichever is nearer) to the
normal maps x and y to tangents. The denominator 1 + |n_z| is at least 1, so no direction is
special; it is the choice of sign discussed by Duff et al. (2017), Building an Orthonormal Basis,
Revisited.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.matrix_types import mat23d

wp.set_module_options({"enable_backward": False})


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
