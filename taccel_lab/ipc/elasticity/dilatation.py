# SPDX-License-Identifier: Apache-2.0
"""The volumetric part of an energy, cut off so that an element can take it of its mean dilatation.

All materials here are affine in lambda: psi(F) = psi(F; mu, 0) + lambda u(e), with the dilatation
e = J - 1 (e = tr E, E the Green strain, for St. Venant-Kirchhoff) and a function u of a number. An
element that evaluates u at the mean of e over its volume has one pressure lambda u' and cannot lock
as lambda grows: it resists a change of its own volume, not of that around each quadrature point
[Nagtegaal, Parks and Rice 1974; Simo, Taylor and Pister 1985, the mean-dilatation method].
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.invariants import (
    cofactor,
    displacement_invariants,
    displacement_trace,
)
from taccel_lab.ipc.elasticity.neo_hookean import log_excess
from taccel_lab.ipc.elasticity.st_venant_kirchhoff import green_strain

wp.set_module_options({"enable_backward": False})


@wp.func
def volume_growth(f: wp.mat33d) -> wp.float64:
    """J - 1, without the cancellation of its two terms near rest."""
    invariants = displacement_invariants(f)
    return displacement_trace(f) + invariants[1] + invariants[2]


@wp.func
def volume_growth_slope(f: wp.mat33d) -> wp.mat33d:
    """d(J - 1)/dF."""
    return cofactor(f)


@wp.func
def strain_trace(f: wp.mat33d) -> wp.float64:
    """tr E."""
    return wp.trace(green_strain(f))


@wp.func
def strain_trace_slope(f: wp.mat33d) -> wp.mat33d:
    """d(tr E)/dF."""
    return f


@wp.func
def half_log_square(e: wp.float64) -> wp.vec3d:
    """u = ln(1 + e)^2 / 2 and its first two derivatives; u = +inf where e <= -1."""
    one = wp.float64(1.0)
    j = one + e
    if not (j > wp.float64(0.0)):
        return wp.vec3d(wp.float64(wp.inf), wp.float64(0.0), wp.float64(0.0))
    log_j = e - log_excess(e)
    return wp.vec3d(wp.float64(0.5) * log_j * log_j, log_j / j, (one - log_j) / (j * j))


@wp.func
def half_square(e: wp.float64) -> wp.vec3d:
    """u = e^2 / 2 and its first two derivatives."""
    return wp.vec3d(wp.float64(0.5) * e * e, e, wp.float64(1.0))
