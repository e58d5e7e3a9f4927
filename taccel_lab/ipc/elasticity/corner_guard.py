# SPDX-License-Identifier: Apache-2.0
"""What keeps a corner of a quadratic tet from turning inside out.

    g(J) = -(1 - y)^2 ln y,  y = J / J0, for J < J0 = 0.2, else 0

the barrier of [Li et al. 2020, eq. 6] in the volume ratio J instead of a distance: twice
differentiable at J0, infinite at J = 0.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.invariants import hessian_of_slopes
from taccel_lab.ipc.elasticity.principal import PrincipalHessian
from taccel_lab.ipc.svd import signed_svd_3x3

wp.set_module_options({"enable_backward": False})

GUARDED_RATIO = wp.constant(wp.float64(0.2))
"""J0: a corner of a gel under a sharp edge gets there, one under a finger tip does not."""


@wp.func
def corner_guard(j: wp.float64) -> wp.vec3d:
    """g and its first two derivatives; +inf where J <= 0."""
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    if j >= GUARDED_RATIO:
        return wp.vec3d(zero, zero, zero)
    if not (j > zero):
        return wp.vec3d(wp.float64(wp.inf), zero, zero)
    y = j / GUARDED_RATIO
    rest = one - y
    log_y = wp.log(y)
    return wp.vec3d(
        -rest * rest * log_y,
        (two * rest * log_y - rest * rest / y) / GUARDED_RATIO,
        (rest * (two + two + rest / y) / y - two * log_y) / (GUARDED_RATIO * GUARDED_RATIO),
    )


@wp.func
def volume_hessian(
    f: wp.mat33d, slope: wp.float64, curvature: wp.float64, mode: int
) -> PrincipalHessian:
    """Hessian of a function of J with these derivatives; negative eigenvalues treated as ``mode``
    says (PSD_*)."""
    u, s, v = signed_svd_3x3(f)
    zero = wp.float64(0.0)
    slopes = wp.vec3d(zero, zero, slope)
    return hessian_of_slopes(u, s, v, slopes, wp.vec3d(zero, zero, curvature), mode)
