# SPDX-License-Identifier: Apache-2.0
"""Vertices of affine bodies as weighted sums of control nodes, forwards and transposed.

A vertex is x = y0 + sum_k w_k y_k with constant weights [Lan et al. 2022, eq. 2], so positions and
displacements follow alike, and d energy / d y_k = sum over vertices of w_k d energy / d x.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.reduce import block_total
from taccel_lab.model import Model
from taccel_lab.scene.mass_properties import MassProperties

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _embed_kernel(
    first: int,
    parents: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.vec4d),
    values: wp.array2d(dtype=wp.vec3d),
):
    env, i = wp.tid()
    node = first + i
    y = parents[node]
    w = weights[node]
    values[env, node] = (
        w[0] * values[env, y]
        + w[1] * values[env, y + 1]
        + w[2] * values[env, y + 2]
        + w[3] * values[env, y + 3]
    )


def embed_vertices(model: Model, values: wp.array) -> None:
    """Overwrite positions or displacements [m] of affine vertices from their control nodes."""
    affine = model.affine
    if affine.count == 0:
        return
    first = affine.first_control + 4 * affine.count
    last = model.bodies[len(model.scene.soft_bodies) + affine.count - 1].nodes[1]
    wp.launch(
        _embed_kernel,
        dim=(model.env_count, last - first),
        inputs=[first, model.parents, model.weights],
        outputs=[values],
        device=model.device,
    )


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


def control_positions(solid: MassProperties, pose: np.ndarray) -> np.ndarray:
    """Control nodes y0..y3 [m] of a body at poses [..., 7], shape [..., 4, 3]."""
    local = np.concatenate([solid.center_m[None], solid.radius_m * solid.axes.T])
    turned = rotate(pose[..., None, 3:], local)
    turned[..., 0, :] += pose[..., :3]
    return turned


def rotate(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors [..., 3] turned by unit quaternions (x, y, z, w) [..., 4]."""
    axis, scalar = quaternion[..., :3], quaternion[..., 3:]
    twice = 2 * np.cross(axis, vector)
    return vector + scalar * twice + np.cross(axis, twice)
