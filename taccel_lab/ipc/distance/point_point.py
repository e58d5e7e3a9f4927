# SPDX-License-Identifier: Apache-2.0
"""Distance of two points (stencil nodes 0 and 1)."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.distance.closest_pair import ClosestPair

wp.set_module_options({"enable_backward": False})


@wp.func
def closest_point_point(p0: wp.vec3d, p1: wp.vec3d) -> ClosestPair:
    """Closest pair of two points; positions [m]."""
    pair = ClosestPair()
    pair.weights[0] = wp.float64(1.0)
    pair.weights[1] = wp.float64(-1.0)
    pair.offset = p0 - p1
    pair.distance_sq = wp.dot(pair.offset, pair.offset)
    return pair
