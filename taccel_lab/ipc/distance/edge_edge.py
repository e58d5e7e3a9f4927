# SPDX-License-Identifier: Apache-2.0
"""Distance of two segments (stencil nodes 0, 1; 2, 3).

The squared distance is a convex quadratic of the two segment parameters on the unit square: its
minimum is the interior stationary point or lies on the boundary, which is four point-segment
queries. Parallel segments have a minimum on the boundary, so they need no case of their own.
"""

from __future__ import annotations

from enum import IntEnum

import warp as wp

from taccel_lab.ipc.distance.closest_pair import ClosestPair, edge_parameter, plane_parameters

wp.set_module_options({"enable_backward": False})


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
