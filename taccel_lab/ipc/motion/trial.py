# SPDX-License-Identifier: Apache-2.0
"""Where nodes are part of the way ahead: those that go straight, and what all others share.

What a frame carries (``kinematic_nodes``) and affine bodies (``affine.bent_step``) go other ways.
Each of the three places its own nodes and reads none of the others', so that they run side by side.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.device.sums import BLOCK_THREADS
from taccel_lab.model import Model
from taccel_lab.model.embedding import vertex_range
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})


@wp.struct
class Trial:
    """A part of the way ahead, and where it leads.

    mask: environments that try it, [env_count].
    curved: those of them in which a node may leave the straight way, [env_count].
    fractions: part of the way, [env_count].
    positions, displacements: start and way of the nodes [m], [env_count, node_count].
    result: where they are then [m]; paths: how they got there, of environments in ``curved`` [m].
    """

    mask: wp.array(dtype=wp.int32)
    curved: wp.array(dtype=wp.int32)
    fractions: wp.array(dtype=wp.float64)
    positions: wp.array2d(dtype=wp.vec3d)
    displacements: wp.array2d(dtype=wp.vec3d)
    result: wp.array2d(dtype=wp.vec3d)
    paths: wp.array2d(dtype=wp.vec3d)


@wp.func
def straight(env: int, node: int, t: Trial) -> wp.vec3d:
    """Where a node is that goes straight [m]."""
    return t.positions[env, node] + t.fractions[env] * t.displacements[env, node]


@wp.func
def put_node(env: int, node: int, x: wp.vec3d, t: Trial):
    """Note where a node is [m]."""
    t.result[env, node] = x
    if t.curved[env] != 0:
        t.paths[env, node] = x - t.positions[env, node]


@wp.kernel
def _straight_kernel(nodes: wp.array(dtype=wp.int32), t: Trial):
    env, i = wp.tid()
    if t.mask[env] != 0:
        put_node(env, nodes[i], straight(env, nodes[i], t), t)


class StraightNodes:
    """Nodes that follow neither a frame nor an affine body."""

    def __init__(self, model: Model) -> None:
        self._model = model
        others = np.ones(model.node_count, dtype=bool)
        others[model.frame_nodes.numpy()] = False
        others[model.affine.first_control : vertex_range(model)[1]] = False
        others[model.affine.carried.numpy()] = False
        nodes = np.flatnonzero(others).astype(np.int32)
        self.nodes = wp.array(nodes, dtype=wp.int32, device=model.device)

    def place(self, trial: Trial) -> None:
        """Put them where ``trial`` leads."""
        if len(self.nodes):
            launch(_straight_kernel, (self._model.env_count, len(self.nodes)), self.nodes, trial)
