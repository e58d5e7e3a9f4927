# SPDX-License-Identifier: Apache-2.0
"""Continuous collision detection along straight node paths, never late.

Additive advancement (Li et al. 2021, Codimensional Incremental Potential Contact, section 5): move
on by a lower bound of the time at which the gap falls to `slackness` of the first, until it has.
The bound is the larger of two:
  * theirs, (gap to lose) / (fastest relative motion of the two primitives);
  * the separating-plane bound of conservative advancement (Mirtich 1996): with n the current
    contact normal, the primitives stay apart along n for (gap along n) / (closing speed along n),
    where gap and speed are extremes over vertex pairs. It holds for any unit n, hence also when
    the closest points are inaccurate, and it lets a contact slide along a face in one step where
    the first bound creeps.
A gap counts only beyond the rounding of the positions. When the iteration cap is reached the time
found so far is returned: it is late never, only early.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.distance.closest_pairs import (
    ClosestPair,
    closest_edge_edge,
    closest_point_triangle,
    combine,
)

wp.set_module_options({"enable_backward": False})

CCD_NO_HIT = wp.constant(0)
"""No collision up to t_max; toi = t_max."""
CCD_HIT = wp.constant(1)
"""The gap falls to the slackness at toi."""
CCD_CAPPED = wp.constant(2)
"""Iteration cap; toi is free of collision, the true time may be later."""
CCD_START = wp.constant(3)
"""Start within the thickness, or not separable in FP64 there, or not a number; toi = 0."""

# Rounding of a distance relative to the lengths of the stencil and its path: about 10 ulp.
_ROUNDING = wp.constant(wp.float64(2.0e-15))
# The target gap is approached from above, in the limit; this multiple of it counts as reached.
_CLOSE_ENOUGH = wp.constant(wp.float64(1.25))


@wp.struct
class CCDResult:
    """Time of impact in [0, t_max], as a fraction of the displacements; a CCD_* status."""

    toi: wp.float64
    status: wp.int32
    iterations: wp.int32


@wp.func
def _extreme_gap(
    edge_edge: wp.bool, n: wp.vec3d, y0: wp.vec3d, y1: wp.vec3d, y2: wp.vec3d, y3: wp.vec3d
) -> wp.float64:
    """Smallest n . (a - b) over vertices a of the first and b of the second primitive."""
    s1 = wp.dot(n, y1)
    first = wp.dot(n, y0)
    second = wp.max(wp.dot(n, y2), wp.dot(n, y3))
    if edge_edge:
        first = wp.min(first, s1)
    else:
        second = wp.max(second, s1)
    return first - second


@wp.func
def _closest(
    edge_edge: wp.bool, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d
) -> ClosestPair:
    if edge_edge:
        return closest_edge_edge(x0, x1, x2, x3)
    return closest_point_triangle(x0, x1, x2, x3)


@wp.func
def _separation(
    edge_edge: wp.bool,
    n: wp.vec3d,
    p0: wp.vec3d,
    p1: wp.vec3d,
    p2: wp.vec3d,
    p3: wp.vec3d,
    v0: wp.vec3d,
    v1: wp.vec3d,
    v2: wp.vec3d,
    v3: wp.vec3d,
    kept: wp.float64,
    t_max: wp.float64,
) -> wp.float64:
    """Time for which a gap of ``kept`` along the unit vector n remains, up to t_max; 0 if none."""
    zero = wp.float64(0.0)
    spare = _extreme_gap(edge_edge, n, p0, p1, p2, p3) - kept
    if not (spare > zero):
        return zero
    closing = -_extreme_gap(edge_edge, n, v0, v1, v2, v3)
    if closing * t_max <= spare:
        return t_max
    return spare / closing


@wp.func
def _feature_normal(
    pair: ClosestPair, n: wp.vec3d, p0: wp.vec3d, p1: wp.vec3d, p2: wp.vec3d, p3: wp.vec3d
) -> wp.vec3d:
    """The normal n to full precision, from the directions in which the closest points can slide.

    In a narrow gap the offset is mostly rounding, and a vector that leans by its error loses the
    gap over the length of a feature.
    """
    along = wp.normalize(combine(pair.dweights_a, p0, p1, p2, p3))
    if pair.free_count == 1:
        return wp.normalize(n - wp.dot(n, along) * along)
    face = wp.normalize(wp.cross(along, combine(pair.dweights_b, p0, p1, p2, p3)))
    if wp.dot(face, n) < wp.float64(0.0):
        return -face
    return face


@wp.func
def _advance(
    edge_edge: wp.bool,
    x0: wp.vec3d,
    x1: wp.vec3d,
    x2: wp.vec3d,
    x3: wp.vec3d,
    dx0: wp.vec3d,
    dx1: wp.vec3d,
    dx2: wp.vec3d,
    dx3: wp.vec3d,
    thickness: wp.float64,
    slackness: wp.float64,
    t_max: wp.float64,
    max_iterations: wp.int32,
) -> CCDResult:
    """Both queries; node 0 is the origin and moves with the mean displacement taken out."""
    zero = wp.float64(0.0)
    result = CCDResult()
    mean = wp.float64(0.25) * (dx0 + dx1 + dx2 + dx3)
    v0 = dx0 - mean
    v1 = dx1 - mean
    v2 = dx2 - mean
    v3 = dx3 - mean
    r1 = x1 - x0
    r2 = x2 - x0
    r3 = x3 - x0
    l0 = wp.length(v0)
    l1 = wp.length(v1)
    l23 = wp.max(wp.length(v2), wp.length(v3))
    speed = l0 + wp.max(l1, l23)
    if edge_edge:
        speed = wp.max(l0, l1) + l23
    if speed == zero:
        result.toi = t_max
        return result
    # A sum, not a maximum, which would swallow NaN.
    size = wp.length(r1) + wp.length(r2) + wp.length(r3)
    floor = thickness + _ROUNDING * (size + speed)

    enough = zero
    result.status = CCD_CAPPED
    while result.iterations < max_iterations:
        t = result.toi
        p0 = t * v0
        p1 = r1 + t * v1
        p2 = r2 + t * v2
        p3 = r3 + t * v3
        pair = _closest(edge_edge, p0, p1, p2, p3)
        distance = wp.sqrt(pair.distance_sq)
        gap = distance - floor
        if result.iterations == 0:
            if not (gap > zero):  # so written that NaN positions end here
                result.status = CCD_START
                return result
            enough = slackness * gap
        elif gap <= _CLOSE_ENOUGH * enough:
            result.status = CCD_HIT
            return result
        result.iterations += 1
        step = (gap - enough) / speed
        kept = floor + enough
        n = pair.offset / distance
        step = wp.max(step, _separation(edge_edge, n, p0, p1, p2, p3, v0, v1, v2, v3, kept, t_max))
        if pair.free_count > 0:
            n = _feature_normal(pair, n, p0, p1, p2, p3)
            step = wp.max(
                step, _separation(edge_edge, n, p0, p1, p2, p3, v0, v1, v2, v3, kept, t_max)
            )
        result.toi = t + step
        if result.toi >= t_max:
            result.toi = t_max
            result.status = CCD_NO_HIT
            return result
    return result


@wp.func
def point_triangle_ccd(
    p: wp.vec3d,
    t0: wp.vec3d,
    t1: wp.vec3d,
    t2: wp.vec3d,
    dp: wp.vec3d,
    dt0: wp.vec3d,
    dt1: wp.vec3d,
    dt2: wp.vec3d,
    thickness: wp.float64,
    slackness: wp.float64,
    t_max: wp.float64,
    max_iterations: wp.int32,
) -> CCDResult:
    """Time of impact of a moving point and triangle; positions and displacements [m].

    thickness: distance that must remain [m]. slackness: fraction in (0, 1) of the first gap (beyond
    the thickness) that is left at the time found, 0.1 is usual. A pair without relative motion is
    never a hit, wherever it starts.
    """
    return _advance(
        False, p, t0, t1, t2, dp, dt0, dt1, dt2, thickness, slackness, t_max, max_iterations
    )


@wp.func
def edge_edge_ccd(
    ea0: wp.vec3d,
    ea1: wp.vec3d,
    eb0: wp.vec3d,
    eb1: wp.vec3d,
    dea0: wp.vec3d,
    dea1: wp.vec3d,
    deb0: wp.vec3d,
    deb1: wp.vec3d,
    thickness: wp.float64,
    slackness: wp.float64,
    t_max: wp.float64,
    max_iterations: wp.int32,
) -> CCDResult:
    """Time of impact of two moving segments; arguments as in `point_triangle_ccd`."""
    return _advance(
        True,
        ea0,
        ea1,
        eb0,
        eb1,
        dea0,
        dea1,
        deb0,
        deb1,
        thickness,
        slackness,
        t_max,
        max_iterations,
    )


@wp.func
def point_point_ccd(
    p: wp.vec3d,
    q: wp.vec3d,
    dp: wp.vec3d,
    dq: wp.vec3d,
    thickness: wp.float64,
    slackness: wp.float64,
    t_max: wp.float64,
) -> CCDResult:
    """Time at which two moving points are down to the slackness over a distance; closed form."""
    zero = wp.float64(0.0)
    r = q - p
    v = dq - dp
    floor = thickness + _ROUNDING * (wp.length(r) + wp.length(v))
    gap = wp.length(r) - floor
    result = CCDResult()
    result.toi = t_max
    closing = -wp.dot(r, v)
    if closing <= zero:
        return result
    if not (gap > zero):
        result.toi = zero
        result.status = CCD_START
        return result
    kept = floor + slackness * gap
    # |r|^2 - kept^2 from the gap, which is far smaller than the two.
    c = (wp.float64(1.0) - slackness) * gap * (wp.length(r) + kept)
    discriminant = closing * closing - wp.dot(v, v) * c
    if discriminant <= zero:
        return result
    toi = c / (closing + wp.sqrt(discriminant))
    if toi < t_max:
        result.toi = toi
        result.status = CCD_HIT
    return result


@wp.func
def point_plane_ccd(
    p: wp.vec3d,
    origin: wp.vec3d,
    normal: wp.vec3d,
    dp: wp.vec3d,
    dorigin: wp.vec3d,
    thickness: wp.float64,
    slackness: wp.float64,
    t_max: wp.float64,
) -> CCDResult:
    """Time at which a point is down to the slackness over a translating plane; closed form.

    normal: unit, towards the free side. A point behind the plane counts as CCD_START.
    """
    zero = wp.float64(0.0)
    result = CCDResult()
    offset = p - origin
    motion = dp - dorigin
    gap = wp.dot(offset, normal) - thickness
    gap -= _ROUNDING * (wp.length(offset) + wp.length(motion))
    closing = -wp.dot(motion, normal)
    result.toi = t_max
    if closing <= zero:
        return result
    if not (gap > zero):
        result.toi = zero
        result.status = CCD_START
        return result
    toi = (wp.float64(1.0) - slackness) * gap / closing
    if toi < t_max:
        result.toi = toi
        result.status = CCD_HIT
    return result
