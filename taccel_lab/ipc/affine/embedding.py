# SPDX-License-Identifier: Apache-2.0
"""Vertices of affine bodies as weighted sums of control nodes, forwards and transposed.

A vertex is x = y0 + sum_k w_k y_k with constant weights [Lan et al. 2022, eq. 2], so positions and
displacements follow alike, and d energy / d y_k = sum over vertices of w_k d energy / d x.
"""

from __future__ import annotations

import numpy as np
import warp as wp

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


@wp.func
def pulled_back(
    env: int,
    control: int,
    first: int,
    last: int,
    weights: wp.array(dtype=wp.vec4d),
    gradient_a: wp.array2d(dtype=wp.vec3d),
    gradient_b: wp.array2d(dtype=wp.vec3d),
    gradient_c: wp.array2d(dtype=wp.vec3d),
) -> wp.vec3d:
    """Sum of three gradients of vertices [first, last) in terms of control node number 0..3."""
    total = wp.vec3d()
    for node in range(first, last):
        all_three = gradient_a[env, node] + gradient_b[env, node] + gradient_c[env, node]
        total += weights[node][control] * all_three
    return total


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
