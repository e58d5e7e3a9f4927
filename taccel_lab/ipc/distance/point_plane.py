# SPDX-License-Identifier: Apache-2.0
"""Distance of a point (stencil node 0) and a plane through a node (stencil nodes 1 to 3).

Only the height over the plane counts, so the weights are those of two points and the tangents are
not needed: the distance is linear in the positions and its second derivative is zero.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.distance.closest_pair import ClosestPair

wp.set_module_options({"enable_backward": False})


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
