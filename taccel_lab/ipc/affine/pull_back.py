# SPDX-License-Identifier: Apache-2.0
"""Gradients on vertices of affine bodies, gathered on their control nodes.

The transpose of ``model.embedding``: d energy / d y_k = sum over vertices of w_k d energy / d x.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.reduce import block_total
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _pull_back_kernel(
    mask: wp.array(dtype=wp.int32),
    first_control: int,
    free_index: wp.array(dtype=wp.int32),
    vertex_starts: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.vec4d),
    gradient_a: wp.array2d(dtype=wp.vec3d),
    gradient_b: wp.array2d(dtype=wp.vec3d),
    gradient_c: wp.array2d(dtype=wp.vec3d),
    reduced: wp.array2d(dtype=wp.vec3d),
):
    """One thread block a control node."""
    env, i, lane = wp.tid()
    if mask[env] == 0:
        return
    body = i / 4
    total = wp.vec3d()
    for node in range(vertex_starts[body] + lane, vertex_starts[body + 1], wp.block_dim()):
        all_three = gradient_a[env, node] + gradient_b[env, node] + gradient_c[env, node]
        total += weights[node][i % 4] * all_three
    x = block_total(total[0])
    y = block_total(total[1])
    z = block_total(total[2])
    if lane == 0:
        node = first_control + i
        own = gradient_a[env, node] + gradient_b[env, node] + gradient_c[env, node]
        reduced[env, free_index[node]] = own + wp.vec3d(x, y, z)


def pull_back(model: Model, mask: wp.array, gradients: list[wp.array], reduced: wp.array) -> None:
    """Rows of the control nodes of ``reduced`` [N]: the sum of three nodal gradients of their own,
    and of what acts on the vertices with its weights."""
    affine = model.affine
    if affine.count == 0:
        return
    wp.launch_tiled(
        _pull_back_kernel,
        dim=[model.env_count, 4 * affine.count],
        inputs=[mask, affine.first_control, model.free_index, affine.vertex_starts]
        + [model.weights, *gradients],
        outputs=[reduced],
        block_dim=32,
        device=model.device,
    )
