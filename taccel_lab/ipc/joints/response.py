# SPDX-License-Identifier: Apache-2.0
"""Energy of one row of a joint: an augmented Lagrangian for constraints and limits, and drives.

A constraint g = 0 has the energy lambda g + k/2 g^2, with a multiplier that becomes lambda + k g
once the step has converged; bounds low <= x <= high have k/2 e^2 - lambda^2 / (2 k) with the part
e of x + lambda / k that lies outside of them [Nocedal and Wright 2006, Numerical Optimization,
sec. 17.3 and 17.4; Rockafellar 1973]. The latter has no second derivative where a limit begins to
act, and no stiffness but k: it is the same for a limit that holds a tonne.

A drive is the potential of the implicit step of effort = -stiffness (x - target)
- damping ((x - x_n) / dt - rate): a spring K/2 (x - x_eq)^2 which saturates at the largest effort.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Response:
    """Energy [J] of a row of value x, dE/dx and a bound of d2E/dx2 that is never negative."""

    energy: wp.float64
    slope: wp.float64
    curvature: wp.float64


@wp.func
def equality_response(x: wp.float64, multiplier: wp.float64, k: wp.float64) -> Response:
    """Augmented Lagrangian of x = 0."""
    r = Response()
    r.energy = x * (multiplier + wp.float64(0.5) * k * x)
    r.slope = multiplier + k * x
    r.curvature = k
    return r


@wp.func
def bound_response(
    x: wp.float64, multiplier: wp.float64, k: wp.float64, low: wp.float64, high: wp.float64
) -> Response:
    """Augmented Lagrangian of low <= x <= high; the multiplier is positive at ``high``."""
    r = Response()
    half = wp.float64(0.5)
    shifted = x + multiplier / k
    outside = shifted - wp.clamp(shifted, low, high)
    r.energy = half * k * outside * outside - half * multiplier * multiplier / k
    r.slope = k * outside
    if outside != wp.float64(0.0):
        r.curvature = k
    return r


@wp.func
def drive_response(
    x: wp.float64,
    start: wp.float64,
    dt: wp.float64,
    stiffness: wp.float64,
    damping: wp.float64,
    max_effort: wp.float64,
    target: wp.float64,
    rate: wp.float64,
) -> Response:
    """Potential of a drive from coordinate ``start`` towards ``target`` and ``rate``."""
    r = Response()
    half = wp.float64(0.5)
    k = stiffness + damping / dt
    if k == wp.float64(0.0):
        return r
    e = x - (stiffness * target + damping * (start / dt + rate)) / k
    if k * wp.abs(e) <= max_effort:
        r.energy = half * k * e * e
        r.slope = k * e
        r.curvature = k
    else:
        r.energy = max_effort * (wp.abs(e) - half * max_effort / k)
        r.slope = max_effort * wp.sign(e)
    return r
