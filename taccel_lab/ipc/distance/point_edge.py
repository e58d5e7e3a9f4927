# SPDX-License-Identifier: Apache-2.0
"""Distance of a point and a segment (stencil nodes 0; 1, 2)."""

from __future__ import annotations

from enum import IntEnum

import warp as wp

from taccel_lab.ipc.distance.closest_pair import ClosestPair, edge_parameter

wp.set_module_options({"enable_backward": False})


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
