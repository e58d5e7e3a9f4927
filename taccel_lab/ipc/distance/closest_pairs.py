# SPDX-License-Identifier: Apache-2.0
"""The closest points of points, edges and triangles on a stencil of four nodes.

Every distance of the contact model is `d = |r|` with `r = sum_i w_i x_i`, where the signed weights
`w` (sum zero) are affine in zero, one or two free closest-point parameters `beta`. All derivatives
of `d` follow from `w`, `dw/dbeta` and the positions (`derivatives.py`), so one structure serves
point-point, point-edge, point-triangle and edge-edge pairs and no formula is written per region.

Two points are stencil nodes 0 and 1; a point and a segment 0 and 1, 2; a point and a plane or a
triangle 0 and 1 to 3; two segments 0, 1 and 2, 3.

Of a plane only the height over it counts, so the weights are those of two points and the tangents
are not needed: the distance is linear in the positions and its second derivative is zero.

Of a triangle the face is tried first; where the foot of the perpendicular lies outside, or the
triangle has no area, the closest point of a convex polygon is on its boundary, hence the nearest of
three edges. No region test can then pick a wrong feature by rounding: at worst it picks an equally
near one.

The squared distance of two segments is a convex quadratic of the two segment parameters on the unit
square: its minimum is the interior stationary point or lies on the boundary, which is four point-
segment queries. Parallel segments have a minimum on the boundary, so they need no case.
"""

from __future__ import annotations

from enum import IntEnum

import warp as wp

wp.set_module_options({"enable_backward": False})

# sin^2 of the angle below which two directions count as parallel: rounding leaves a cross product
# of unit vectors about 1e-16 off, so at an angle of 1e-12 it still has four digits.
PARALLEL_SIN_SQ = wp.constant(wp.float64(1.0e-24))


@wp.struct
class ClosestPair:
    """Closest points of two primitives of a stencil x0..x3.

    region: code of the region enum of the query (which vertex, edge or face is closest).
    free_count: closest-point parameters inside their range: 0 point-point, 1 point-edge, 2 both.
    weights: signed weights [-], sum 0; `offset = sum_i weights[i] x_i`.
    dweights_a, dweights_b: derivative of the weights by the free parameters (zero if not free).
    offset: vector between the closest points, from the second primitive to the first [m].
    distance_sq: |offset|^2 [m^2].
    """

    region: wp.int32
    free_count: wp.int32
    weights: wp.vec4d
    dweights_a: wp.vec4d
    dweights_b: wp.vec4d
    offset: wp.vec3d
    distance_sq: wp.float64


@wp.func
def combine(weights: wp.vec4d, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d) -> wp.vec3d:
    """Weighted sum of the nodes for weights that sum to zero; exact cancellation of a common shift.

    Differences come first so that a pair far from the origin keeps its digits.
    """
    return weights[1] * (x1 - x0) + weights[2] * (x2 - x0) + weights[3] * (x3 - x0)


@wp.func
def edge_parameter(offset: wp.vec3d, edge: wp.vec3d) -> wp.float64:
    """Parameter in [0, 1] of the point of a segment that is closest to a point.

    offset: the point relative to the start of the segment [m]; edge: end relative to start [m]. A
    segment of no length has parameter 0.
    """
    length_sq = wp.dot(edge, edge)
    if length_sq <= wp.float64(0.0):
        return wp.float64(0.0)
    return wp.clamp(wp.dot(offset, edge) / length_sq, wp.float64(0.0), wp.float64(1.0))


@wp.func
def plane_parameters(u: wp.vec3d, v: wp.vec3d, r: wp.vec3d) -> wp.vec2d:
    """Least-squares (a, b) of a u + b v = r; (-1, -1) when u and v are parallel.

    Cross products instead of the 2x2 normal equations: those square the condition number. A second
    pass on the residual removes what rounding left.
    """
    n = wp.cross(u, v)
    n_sq = wp.dot(n, n)
    if n_sq <= PARALLEL_SIN_SQ * wp.dot(u, u) * wp.dot(v, v):
        return wp.vec2d(wp.float64(-1.0), wp.float64(-1.0))
    a = wp.dot(wp.cross(r, v), n) / n_sq
    b = wp.dot(wp.cross(u, r), n) / n_sq
    rest = r - a * u - b * v
    a += wp.dot(wp.cross(rest, v), n) / n_sq
    b += wp.dot(wp.cross(u, rest), n) / n_sq
    return wp.vec2d(a, b)


@wp.func
def closest_point_point(p0: wp.vec3d, p1: wp.vec3d) -> ClosestPair:
    """Closest pair of two points; positions [m]."""
    pair = ClosestPair()
    pair.weights[0] = wp.float64(1.0)
    pair.weights[1] = wp.float64(-1.0)
    pair.offset = p0 - p1
    pair.distance_sq = wp.dot(pair.offset, pair.offset)
    return pair


class PointEdgeRegion(IntEnum):
    """Feature of the segment that is closest to the point."""

    V0 = 0
    V1 = 1
    E = 2


@wp.func
def closest_point_edge(p: wp.vec3d, e0: wp.vec3d, e1: wp.vec3d) -> ClosestPair:
    """Closest pair of a point and a segment; positions [m]. A segment of no length is its point."""
    t = edge_parameter(p - e0, e1 - e0)
    pair = ClosestPair()
    pair.weights = wp.vec4d(wp.float64(1.0), t - wp.float64(1.0), -t, wp.float64(0.0))
    pair.region = wp.static(int(PointEdgeRegion.V0))
    if t >= wp.float64(1.0):
        pair.region = wp.static(int(PointEdgeRegion.V1))
    elif t > wp.float64(0.0):
        pair.region = wp.static(int(PointEdgeRegion.E))
        pair.free_count = 1
        pair.dweights_a[1] = wp.float64(1.0)
        pair.dweights_a[2] = wp.float64(-1.0)
    pair.offset = (p - e0) - t * (e1 - e0)
    pair.distance_sq = wp.dot(pair.offset, pair.offset)
    return pair


@wp.func
def point_edge_distance_sq(p: wp.vec3d, e0: wp.vec3d, e1: wp.vec3d) -> wp.float64:
    """Squared distance of a point and a segment [m^2]."""
    return wp.length_sq((p - e0) - edge_parameter(p - e0, e1 - e0) * (e1 - e0))


@wp.func
def closest_point_plane(p: wp.vec3d, origin: wp.vec3d, normal: wp.vec3d) -> ClosestPair:
    """Closest pair of a point and the plane through ``origin``; positions [m].

    normal: unit, towards the free side. A point behind the plane is at distance zero, where every
    barrier is infinite.
    """
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    height = wp.max(wp.dot(p - origin, normal), zero)
    pair = ClosestPair()
    pair.weights = wp.vec4d(one, -one, zero, zero)
    pair.offset = height * normal
    pair.distance_sq = height * height
    return pair


class PointTriangleRegion(IntEnum):
    """Feature of the triangle closest to the point; E0 = t0 t1, E1 = t1 t2, E2 = t2 t0."""

    V0 = 0
    V1 = 1
    V2 = 2
    E0 = 3
    E1 = 4
    E2 = 5
    T = 6


@wp.func
def _boundary_pair(p: wp.vec3d, t0: wp.vec3d, t1: wp.vec3d, t2: wp.vec3d) -> ClosestPair:
    """Closest pair of a point and the outline of a triangle."""
    d0 = point_edge_distance_sq(p, t0, t1)
    d1 = point_edge_distance_sq(p, t1, t2)
    d2 = point_edge_distance_sq(p, t2, t0)
    edge = int(0)
    a = t0
    b = t1
    if d1 < d0 and d1 <= d2:
        edge = 1
        a = t1
        b = t2
    elif d2 < d0:
        edge = 2
        a = t2
        b = t0
    t = edge_parameter(p - a, b - a)
    first = 1 + edge
    second = 1 + (edge + 1) % 3
    pair = ClosestPair()
    pair.weights[0] = wp.float64(1.0)
    pair.weights[first] = t - wp.float64(1.0)
    pair.weights[second] = -t
    pair.region = edge
    if t >= wp.float64(1.0):
        pair.region = (edge + 1) % 3
    elif t > wp.float64(0.0):
        pair.region = wp.static(int(PointTriangleRegion.E0)) + edge
        pair.free_count = 1
        pair.dweights_a[first] = wp.float64(1.0)
        pair.dweights_a[second] = wp.float64(-1.0)
    pair.offset = (p - a) - t * (b - a)
    pair.distance_sq = wp.dot(pair.offset, pair.offset)
    return pair


@wp.func
def closest_point_triangle(p: wp.vec3d, t0: wp.vec3d, t1: wp.vec3d, t2: wp.vec3d) -> ClosestPair:
    """Closest pair of a point and a triangle; positions [m]; any triangle, also without area."""
    pair = _boundary_pair(p, t0, t1, t2)
    beta = plane_parameters(t1 - t0, t2 - t0, p - t0)
    inside = beta[0] > wp.float64(0.0) and beta[1] > wp.float64(0.0)
    if inside and beta[0] + beta[1] < wp.float64(1.0):
        one = wp.float64(1.0)
        zero = wp.float64(0.0)
        weights = wp.vec4d(one, beta[0] + beta[1] - one, -beta[0], -beta[1])
        offset = combine(weights, p, t0, t1, t2)
        if wp.dot(offset, offset) <= pair.distance_sq:
            pair.region = wp.static(int(PointTriangleRegion.T))
            pair.free_count = 2
            pair.weights = weights
            pair.dweights_a = wp.vec4d(zero, one, -one, zero)
            pair.dweights_b = wp.vec4d(zero, one, zero, -one)
            pair.offset = offset
            pair.distance_sq = wp.dot(offset, offset)
    return pair


@wp.func
def point_triangle_distance_sq(p: wp.vec3d, t0: wp.vec3d, t1: wp.vec3d, t2: wp.vec3d) -> wp.float64:
    """Squared distance of a point and a triangle [m^2]."""
    return closest_point_triangle(p, t0, t1, t2).distance_sq


class EdgeEdgeRegion(IntEnum):
    """Features of the two segments that are closest; EA is the inside of segment a."""

    EA0_EB0 = 0
    EA0_EB1 = 1
    EA1_EB0 = 2
    EA1_EB1 = 3
    EA_EB0 = 4
    EA_EB1 = 5
    EA0_EB = 6
    EA1_EB = 7
    EA_EB = 8


@wp.func
def _nearer(
    best: wp.vec3d, s: wp.float64, t: wp.float64, start: wp.vec3d, u: wp.vec3d, v: wp.vec3d
) -> wp.vec3d:
    """The nearer of `best` = (s, t, squared distance) and the trial parameters."""
    distance_sq = wp.length_sq(start + s * u - t * v)
    if distance_sq < best[2]:
        return wp.vec3d(s, t, distance_sq)
    return best


@wp.func
def _closest_parameters(start: wp.vec3d, u: wp.vec3d, v: wp.vec3d) -> wp.vec3d:
    """Parameters s, t in [0, 1] that minimise |start + s u - t v|^2, and the minimum [m^2].

    start = ea0 - eb0; u and v are the edges a and b [m].
    """
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    t0 = edge_parameter(start, v)
    best = wp.vec3d(zero, t0, wp.length_sq(start - t0 * v))
    best = _nearer(best, one, edge_parameter(start + u, v), start, u, v)
    best = _nearer(best, edge_parameter(-start, u), zero, start, u, v)
    best = _nearer(best, edge_parameter(v - start, u), one, start, u, v)
    beta = plane_parameters(u, -v, -start)
    if beta[0] > zero and beta[0] < one and beta[1] > zero and beta[1] < one:
        # On nearly parallel segments the two parameters carry separate rounding errors; each is
        # recomputed from the other, which leaves only an error along both, where d is flat.
        t = edge_parameter(start + beta[0] * u, v)
        s = edge_parameter(t * v - start, u)
        best = _nearer(best, s, t, start, u, v)
    return best


@wp.func
def closest_edge_edge(ea0: wp.vec3d, ea1: wp.vec3d, eb0: wp.vec3d, eb1: wp.vec3d) -> ClosestPair:
    """Closest pair of two segments; positions [m]; any segments, also parallel or of no length."""
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    beta = _closest_parameters(ea0 - eb0, ea1 - ea0, eb1 - eb0)
    s = beta[0]
    t = beta[1]
    free_s = s > zero and s < one
    free_t = t > zero and t < one
    along_a = wp.vec4d(-one, one, zero, zero)
    along_b = wp.vec4d(zero, zero, one, -one)
    pair = ClosestPair()
    if free_s and free_t:
        pair.region = wp.static(int(EdgeEdgeRegion.EA_EB))
        pair.free_count = 2
        pair.dweights_a = along_a
        pair.dweights_b = along_b
    elif free_s:
        pair.region = wp.static(int(EdgeEdgeRegion.EA_EB0)) + int(t)
        pair.free_count = 1
        pair.dweights_a = along_a
    elif free_t:
        pair.region = wp.static(int(EdgeEdgeRegion.EA0_EB)) + int(s)
        pair.free_count = 1
        pair.dweights_a = along_b
    else:
        pair.region = 2 * int(s) + int(t)
    pair.weights = wp.vec4d(one - s, s, t - one, -t)
    pair.offset = (ea0 - eb0) + s * (ea1 - ea0) - t * (eb1 - eb0)
    pair.distance_sq = wp.dot(pair.offset, pair.offset)
    return pair


@wp.func
def edge_edge_distance_sq(ea0: wp.vec3d, ea1: wp.vec3d, eb0: wp.vec3d, eb1: wp.vec3d) -> wp.float64:
    """Squared distance of two segments [m^2]."""
    return _closest_parameters(ea0 - eb0, ea1 - ea0, eb1 - eb0)[2]
