# SPDX-License-Identifier: Apache-2.0
"""Gradients on nodes that affine bodies carry along, gathered on their control nodes.

The transpose of ``model.embedding``: d energy / d y_k = sum over these of w_k d energy / d x.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.sums import block_total
from taccel_lab.model import Model
from taccel_lab.model.embedding import Embedded, embedded, embedded_count, embedded_node
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import WARP_THREADS, launch_blocks

wp.set_module_options({"enable_backward": False, "block_dim": WARP_THREADS})


@wp.func
def nodal_sum(
    env: int,
    node: int,
    a: wp.array2d(dtype=wp.vec3d),
    b: wp.array2d(dtype=wp.vec3d),
    c: wp.array2d(dtype=wp.vec3d),
) -> wp.vec3d:
    """Sum of nodal vectors, of which the second and third may be missing."""
    total = a[env, node]
    if b:
        total += b[env, node]
    if c:
        total += c[env, node]
    return total


@wp.kernel
def _pull_back_kernel(
    mask: Envs,
    first_control: int,
    free_index: wp.array(dtype=wp.int32),
    e: Embedded,
    gradient_a: wp.array2d(dtype=wp.vec3d),
    gradient_b: wp.array2d(dtype=wp.vec3d),
    gradient_c: wp.array2d(dtype=wp.vec3d),
    reduced: wp.array2d(dtype=wp.vec3d),
):
    """One thread block a control node."""
    place, i, lane = wp.tid()
    env = env_at(place, mask)
    if env < 0:
        return
    body = i / 4
    total = wp.vec3d()
    for place in range(lane, embedded_count(body, e), wp.block_dim()):
        node = embedded_node(body, place, e)
        force = nodal_sum(env, node, gradient_a, gradient_b, gradient_c)
        total += e.weights[node][i % 4] * force
    x = block_total(total[0])
    y = block_total(total[1])
    z = block_total(total[2])
    if lane == 0:
        node = first_control + i
        own = nodal_sum(env, node, gradient_a, gradient_b, gradient_c)
        reduced[env, free_index[node]] = own + wp.vec3d(x, y, z)


def pull_back(
    model: Model, mask: EnvMask, gradients: list[wp.array | None], reduced: wp.array
) -> None:
    """Rows of the control nodes of ``reduced`` [N]: the sum of three gradients, of which two may be
    None, at these nodes, and of what acts on what the bodies carry, with its weights."""
    affine = model.affine
    if affine.count == 0:
        return
    inputs = [mask, affine.first_control, model.free_index, embedded(model), *gradients, reduced]
    launch_blocks(_pull_back_kernel, (model.env_count, 4 * affine.count), *inputs)
