# SPDX-License-Identifier: Apache-2.0
"""What of a step's motion brought a pair together, and is no sliding.

Friction counts sliding from where the step began. A pair that meets in a step comes from afar, and
where its normal has turned meanwhile, what it came by leans against the tangent plane: a node that
goes 50 um straight to a sharp edge and ends 0.5 um beside it, 5 um away, has a normal of 0.1 rad
and would seem to have slid 5 um. Friction would push it across, its normal tilt to the other side,
and freezing never settle. Seen from the edge, a node at r n that was at r0 n0 has come by
(r - r0) n0 and slid by r (n - n0): the way in is taken along the normal where the step began.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.collision_lists import ContactGeometry, closest_pair
from taccel_lab.ipc.distance.closest_pair import ClosestPair, combine
from taccel_lab.ipc.distance.derivatives import pair_normal

wp.set_module_options({"enable_backward": False})


@wp.func
def way_in(
    env: int,
    kind: int,
    nodes: wp.vec4i,
    pair: ClosestPair,
    now: wp.array2d(dtype=wp.vec3d),
    then: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
) -> wp.vec3d:
    """Relative motion [m] from the positions ``then`` to ``now`` that is no sliding: what it is
    along the normal of ``pair``, the collision now, along the normal that it had then.

    Its length is not that of the gaps: in sliding from one face to the next the gap to a face, and
    the normal with it, may have been anything; along the normal there is hardly any motion.
    """
    moved = combine(
        pair.weights,
        now[env, nodes[0]] - then[env, nodes[0]],
        now[env, nodes[1]] - then[env, nodes[1]],
        now[env, nodes[2]] - then[env, nodes[2]],
        now[env, nodes[3]] - then[env, nodes[3]],
    )
    along = wp.dot(moved, pair_normal(pair))
    return along * pair_normal(closest_pair(env, kind, nodes, then, geometry))
