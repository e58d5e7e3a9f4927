# SPDX-License-Identifier: Apache-2.0
"""Distance of a point and a triangle (stencil nodes 0; 1, 2, 3).

The face is tried first; where the foot of the perpendicular lies outside, or the triangle has no
area, the closest point of a convex polygon is on its boundary, hence the nearest of three edges.
No region test can then pick a wrong feature by rounding: at worst it picks an equally near one.
"""

from __future__ import annotations

from enum import IntEnum

import warp as wp

from taccel_lab.ipc.distance.closest_pair import (
    ClosestPair,
    combine,
    edge_parameter,
    plane_parameters,
)
from taccel_lab.ipc.distance.point_edge import point_edge_distance_sq

wp.set_module_options({"enable_backward": False})


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
