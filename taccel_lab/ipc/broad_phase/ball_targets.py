# SPDX-License-Identifier: Apache-2.0
"""Search against balls: no tree, a distance bound per face."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.broad_phase.boxes import append
from taccel_lab.ipc.device.ragged_lists import ListRoom

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _ball_face_kernel(
    active: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    node_bodies: wp.array(dtype=wp.int32),
    node_radii: wp.array(dtype=wp.float64),
    present: wp.array2d(dtype=wp.int32),
    faces: wp.array(dtype=wp.vec3i),
    margins: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    room: ListRoom,
    pairs: wp.array(dtype=wp.vec2i),
):
    """A ball against a face: a box around the face's path as seen from the ball."""
    env, i = wp.tid()
    ball = jobs[i][0]
    face = faces[jobs[i][1]]
    if active[env] == 0 or present[env, node_bodies[ball]] == 0:
        return
    if present[env, node_bodies[face[0]]] == 0:
        return
    centre = positions[env, ball]
    shift = displacements[env, ball]
    big = wp.float64(1.0e30)
    low = wp.vec3d(big, big, big)
    high = -low
    for k in range(3):
        a = positions[env, face[k]] - centre
        b = a + displacements[env, face[k]] - shift
        low = wp.min(low, wp.min(a, b))
        high = wp.max(high, wp.max(a, b))
    gap_sq = wp.float64(0.0)
    for k in range(3):
        outside = wp.max(wp.max(low[k], -high[k]), wp.float64(0.0))
        gap_sq += outside * outside
    reach = node_radii[ball] + margins[env]
    if gap_sq < reach * reach:
        append(env, ball, jobs[i][1], room, pairs)


BALL_JOBS = _ball_face_kernel
