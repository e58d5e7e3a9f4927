# SPDX-License-Identifier: Apache-2.0
"""Boxes around whole bodies, where they are or along straight ways."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.reduce import BLOCK_THREADS

wp.set_module_options({"enable_backward": False})


@wp.func
def _least(value: wp.float64) -> wp.float64:
    return wp.tile_extract(wp.tile_min(wp.tile(value)), 0)


@wp.func
def _largest(value: wp.float64) -> wp.float64:
    return wp.tile_extract(wp.tile_max(wp.tile(value)), 0)


@wp.kernel
def _body_boxes_kernel(
    mask: wp.array(dtype=wp.int32),
    body_nodes: wp.array(dtype=wp.vec2i),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    lower: wp.array2d(dtype=wp.vec3d),
    upper: wp.array2d(dtype=wp.vec3d),
):
    env, body, lane = wp.tid()
    if mask[env] == 0:
        return
    big = wp.float64(1.0e30)
    low = wp.vec3d(big, big, big)
    high = -low
    for node in range(body_nodes[body][0] + lane, body_nodes[body][1], wp.block_dim()):
        x = positions[env, node]
        low = wp.min(low, x)
        high = wp.max(high, x)
        if displacements:
            end = x + displacements[env, node]
            low = wp.min(low, end)
            high = wp.max(high, end)
    low = wp.vec3d(_least(low[0]), _least(low[1]), _least(low[2]))
    high = wp.vec3d(_largest(high[0]), _largest(high[1]), _largest(high[2]))
    if lane == 0:
        lower[env, body] = low
        upper[env, body] = high


def find_body_boxes(
    mask: wp.array,
    body_nodes: wp.array,
    positions: wp.array,
    displacements: wp.array | None,
    lower: wp.array,
    upper: wp.array,
) -> None:
    """Corners of a box around each body [m], [env_count, body_count], by a thread block each.

    ``body_nodes``: range of the nodes of each body, vec2i, [body_count]; ``displacements``:
    straight ways that the boxes hold, too.
    """
    wp.launch_tiled(
        _body_boxes_kernel,
        dim=list(lower.shape),
        inputs=[mask, body_nodes, positions, displacements],
        outputs=[lower, upper],
        block_dim=BLOCK_THREADS,
        device=positions.device,
    )
