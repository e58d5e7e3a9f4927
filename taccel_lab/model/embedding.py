# SPDX-License-Identifier: Apache-2.0
"""Vertices of affine bodies, and bonded nodes that they carry, as weighted sums of control nodes.

A vertex is x = y0 + sum_k w_k y_k with constant weights [Lan et al. 2022, eq. 2], so positions and
displacements follow alike.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.bodies.mass_properties import MassProperties
from taccel_lab.model.launches import launch
from taccel_lab.model.model import Model

wp.set_module_options({"enable_backward": False})


@wp.struct
class Embedded:
    """Nodes that affine bodies carry along: their vertices, then bonded nodes of gels on them.

    vertex_starts: range of each body in the nodes, [affine_count + 1].
    carried_starts, carried: range of each body in the nodes that follow, [affine_count + 1].
    weights: weights of the control nodes of an embedded node, [node_count].
    """

    vertex_starts: wp.array(dtype=wp.int32)
    carried_starts: wp.array(dtype=wp.int32)
    carried: wp.array(dtype=wp.int32)
    weights: wp.array(dtype=wp.vec4d)


@wp.func
def embedded_count(body: int, e: Embedded) -> int:
    """Nodes that a body carries along."""
    vertices = e.vertex_starts[body + 1] - e.vertex_starts[body]
    return vertices + e.carried_starts[body + 1] - e.carried_starts[body]


@wp.func
def embedded_node(body: int, i: int, e: Embedded) -> int:
    """The i-th of them."""
    node = e.vertex_starts[body] + i
    beyond = node - e.vertex_starts[body + 1]
    if beyond >= 0:
        node = e.carried[e.carried_starts[body] + beyond]
    return node


def embedded(model: Model) -> Embedded:
    """Embedded nodes of a model."""
    result = Embedded()
    result.vertex_starts = model.affine.vertex_starts
    result.carried_starts = model.affine.carried_starts
    result.carried = model.affine.carried
    result.weights = model.weights
    return result


@wp.func
def listed_node(i: int, first: int, count: int, carried: wp.array(dtype=wp.int32)) -> int:
    """The i-th of all embedded nodes: ``count`` vertices from ``first`` on, then ``carried``."""
    if i < count:
        return first + i
    return carried[i - count]


@wp.kernel
def _embed_kernel(
    first: int,
    count: int,
    carried: wp.array(dtype=wp.int32),
    parents: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.vec4d),
    values: wp.array2d(dtype=wp.vec3d),
):
    env, i = wp.tid()
    node = listed_node(i, first, count, carried)
    y = parents[node]
    w = weights[node]
    values[env, node] = (
        w[0] * values[env, y]
        + w[1] * values[env, y + 1]
        + w[2] * values[env, y + 2]
        + w[3] * values[env, y + 3]
    )


def vertex_range(model: Model) -> tuple[int, int]:
    """First vertex of the affine bodies, and the node after their last."""
    affine = model.affine
    first = affine.first_control + 4 * affine.count
    if affine.count == 0:
        return first, first
    return first, model.bodies[len(model.scene.soft_bodies) + affine.count - 1].nodes[1]


def embed_vertices(model: Model, values: wp.array) -> None:
    """Overwrite positions or displacements [m] of embedded nodes from their control nodes."""
    first, end = vertex_range(model)
    if end > first:
        carried = model.affine.carried
        inputs = [first, end - first, carried, model.parents, model.weights, values]
        launch(_embed_kernel, (model.env_count, end - first + len(carried)), *inputs)


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
