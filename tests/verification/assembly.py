# SPDX-License-Identifier: Apache-2.0
"""Energies, gradients and matrices as the solver assembles them, as dense numpy arrays."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.motion.unknowns import newton_system
from taccel_lab.model import Model
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC


class Assembly:
    """The potentials of a model, evaluated anywhere; positions are [env_count, node_count, 3]."""

    def __init__(self, model: Model, config: SolverConfig, poses: np.ndarray) -> None:
        self.model = model
        self.solver = SolverIPC(model, config)
        self.dhat = config.dhat_m
        self.active = wp.full(model.env_count, 1, dtype=wp.int32, device=model.device)
        self.poses = wp.array(poses, dtype=wp.transformd, device=model.device)
        self.free = model.free_nodes.numpy()

    def nodal(self, value: np.ndarray | None = None) -> wp.array:
        if value is None:
            value = np.zeros((self.model.env_count, self.model.node_count, 3))
        return wp.array(value, dtype=wp.vec3d, device=self.model.device)

    def collide(self, positions: np.ndarray) -> int:
        """Collect the collisions at ``positions``; returns their number in environment 0."""
        x = self.nodal(positions)
        s = self.solver
        # Nodes may lie off their body's pose by the step of a finite difference.
        margin = self.dhat + 1e-6
        s.candidates.update(self.active, x, self.nodal(), self.poses, self.poses, margin)
        s.collisions.update(self.active, x, s.candidates)
        return int(s.collisions.counts.numpy()[0])

    def contact_energy(self, positions: np.ndarray) -> np.ndarray:
        self.collide(positions)
        return self.solver.contact.energy(self.active, self.nodal(positions))

    def contact_gradient(self, positions: np.ndarray) -> np.ndarray:
        self.collide(positions)
        out = self.nodal()
        gaps = wp.full(self.model.env_count, np.inf, dtype=wp.float64, device=self.model.device)
        self.solver.contact.add_gradient(self.active, self.nodal(positions), out, gaps)
        return out.numpy()

    def system(self, prescribed: np.ndarray | None = None) -> NewtonSystem:
        """An empty Newton system."""
        linear = self.solver.linear
        linear.values.zero_()
        linear.rhs.zero_()
        linear.extra.clear()
        return newton_system(self.model, linear, self.nodal(prescribed))

    def dense(self, values: wp.array) -> np.ndarray:
        """Full matrices [N/m], shape [env_count, 3 free_count, 3 free_count]."""
        return self.model.pattern.dense(values.numpy())


def coordinate_probe(x: np.ndarray, nodes: np.ndarray, step: float) -> np.ndarray:
    """Positions with each coordinate of ``nodes`` moved both ways, by node, axis, sign (+, -)."""
    probes = np.repeat(x[None], 6 * len(nodes), axis=0)
    row = np.arange(3 * len(nodes))
    node, axis = nodes[row // 3], row % 3
    probes[2 * row, node, axis] += step
    probes[2 * row + 1, node, axis] -= step
    return probes
