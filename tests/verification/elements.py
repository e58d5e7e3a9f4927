# SPDX-License-Identifier: Apache-2.0
"""Elastic and viscous forces of a scene as dense numpy arrays, without the solver, and a Newton
iteration for equilibria under nodal loads."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.elasticity.principal import PSD_CLAMP
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.potentials.elements.data import ElementSum
from taccel_lab.ipc.potentials.elements.elastic import ElasticPotential
from taccel_lab.model import Model


class ElementForces:
    """Sum of element potentials; positions are [env_count, node_count, 3]."""

    def __init__(self, model: Model, parts: list[ElementSum] | None = None) -> None:
        self.model = model
        self.parts = [ElasticPotential(model, g) for g in model.elastic] if parts is None else parts
        self.active = wp.full(model.env_count, 1, dtype=wp.int32, device=model.device)
        self.free = model.free_nodes.numpy()

    def nodal(self, value: np.ndarray | None = None) -> wp.array:
        if value is None:
            value = np.zeros((self.model.env_count, self.model.node_count, 3))
        return wp.array(value, dtype=wp.vec3d, device=self.model.device)

    def energy(self, positions: np.ndarray) -> np.ndarray:
        x = self.nodal(positions)
        return np.sum([part.energy(self.active, x) for part in self.parts], axis=0)

    def gradient(self, positions: np.ndarray) -> np.ndarray:
        x, out = self.nodal(positions), self.nodal()
        for part in self.parts:
            part.add_gradient(self.active, x, out)
        return out.numpy()

    def system(
        self, positions: np.ndarray, mode: int, motion: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Blocks of the matrix [N/m] and right-hand side [N] for a motion of prescribed nodes."""
        m, x = self.model, self.nodal(positions)
        system = NewtonSystem()
        system.values = wp.zeros((m.env_count, m.pattern.block_count), dtype=wp.mat33d)
        system.rhs = wp.zeros((m.env_count, m.free_count), dtype=wp.vec3d)
        system.displacements = self.nodal(motion)
        modes = wp.full(m.env_count, mode, dtype=wp.int32)
        for part in self.parts:
            part.add_hessian(self.active, x, system, modes)
        return system.values.numpy(), system.rhs.numpy()

    def hessian(self, positions: np.ndarray, mode: int) -> np.ndarray:
        """Dense matrix over free nodes [N/m], shape [env_count, 3 free_count, 3 free_count]."""
        return self.model.pattern.dense(self.system(positions, mode)[0])

    def linear_response(self, load: np.ndarray, fixed: np.ndarray | None = None) -> np.ndarray:
        """Displacements [m] of environment 0 by linear elasticity, shape [node_count, 3]."""
        rest = self.model.rest_positions.numpy()[0]
        move = np.zeros_like(rest)
        move[self.free] = self._solve(rest, load[self.free], self._open(fixed))
        return move

    def equilibrium(
        self,
        load: np.ndarray,
        fixed: np.ndarray | None = None,
        start: np.ndarray | None = None,
        tolerance_n: float = 1e-9,
    ) -> tuple[np.ndarray, int]:
        """Positions [node, 3] under nodal forces, and iterations; ``fixed``: held coordinates."""
        x = (self.model.rest_positions.numpy()[0] if start is None else start).copy()
        keep = self._open(fixed)
        force = load[self.free]
        for count in range(60):
            force = (load - self.gradient(x[None])[0])[self.free]
            if np.linalg.norm(force[keep]) <= tolerance_n:
                return x, count
            step = self._solve(x, force, keep)
            alpha, before = 1.0, self._potential(x, load)
            while alpha > 1e-6:
                trial = x.copy()
                trial[self.free] += alpha * step
                if self._potential(trial, load) <= before + 1e-12 * abs(before):
                    x = trial
                    break
                alpha /= 2
            else:
                break
        raise RuntimeError(f"no equilibrium: residual {np.linalg.norm(force[keep]):.1e} N")

    def _open(self, fixed: np.ndarray | None) -> np.ndarray:
        """Coordinates of free nodes that may move, bool, shape [free_count, 3]."""
        everything = np.ones((len(self.free), 3), dtype=bool)
        return everything if fixed is None else ~fixed[self.free]

    def _solve(self, x: np.ndarray, force: np.ndarray, keep: np.ndarray) -> np.ndarray:
        from scipy import sparse
        from scipy.sparse.linalg import spsolve

        pattern, size = self.model.pattern, 3 * len(self.free)
        values = self.system(x[None], PSD_CLAMP)[0][0]
        lower = sparse.bsr_array(
            (values, pattern.columns, pattern.row_starts), shape=(size, size)
        ).tocsr()
        diagonal = sparse.block_diag(list(values[pattern.diagonal]))
        matrix = sparse.csr_array(lower + lower.T - diagonal)
        rows = np.flatnonzero(keep.ravel())
        step = np.zeros(size)
        step[rows] = spsolve(matrix[rows][:, rows].tocsc(), force.ravel()[rows])
        return step.reshape(-1, 3)

    def _potential(self, x: np.ndarray, load: np.ndarray) -> float:
        return float(self.energy(x[None])[0] - (load * x).sum())
