# SPDX-License-Identifier: Apache-2.0
"""Energies, gradients and matrices of one potential as dense numpy arrays over the free nodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.problem.arrays import ExtraBlocks
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.model import Model


def empty_system(model: Model) -> NewtonSystem:
    """A Newton system whose pattern holds every block of the lower triangle."""
    n, env_count, device = model.free_count, model.env_count, model.device

    def ints(value: Any) -> wp.array:
        return wp.array(np.asarray(value), dtype=wp.int32, device=device)

    rows = np.arange(n)
    system = NewtonSystem()
    system.free_index, system.parents, system.weights = (
        model.free_index,
        model.parents,
        model.weights,
    )
    system.row_starts = ints(np.concatenate([[0], np.cumsum(rows + 1)]))
    system.columns = ints(np.concatenate([np.arange(row + 1) for row in rows]))
    system.values = wp.zeros((env_count, n * (n + 1) // 2), dtype=wp.mat33d, device=device)
    extra = ExtraBlocks(env_count, device, 0)
    system.extra_room, system.extra_places = extra.room, extra.places
    system.extra_values = extra.values
    system.rhs = wp.zeros((env_count, n), dtype=wp.vec3d, device=device)
    system.displacements = wp.zeros((env_count, model.node_count), dtype=wp.vec3d, device=device)
    return system


def dense(model: Model, system: NewtonSystem) -> np.ndarray:
    """Symmetric matrices, shape [env_count, 3 free_count, 3 free_count]."""
    n = model.free_count
    rows, columns = np.tril_indices(n)
    values = system.values.numpy()
    full = np.zeros((len(values), n, n, 3, 3))
    full[:, columns, rows] = np.swapaxes(values, -1, -2)
    full[:, rows, columns] = values
    return full.transpose(0, 1, 3, 2, 4).reshape(len(values), 3 * n, 3 * n)


class Dense:
    """A potential evaluated in any number of configurations of the free nodes.

    Configurations [count, free_count, 3] are dealt out to the environments of the model.
    """

    def __init__(self, model: Model, potential: Any, base: np.ndarray) -> None:
        self.model, self.potential = model, potential
        self.base = base
        """All nodes of environment 0 [m], shape [node_count, 3]."""
        self.free = model.free_nodes.numpy()
        self.active = wp.full(model.env_count, 1, dtype=wp.int32, device=model.device)

    def positions(self, free: np.ndarray) -> wp.array:
        """Node positions of a batch, padded to the number of environments."""
        batch = np.repeat(self.base[None], self.model.env_count, axis=0)
        batch[: len(free), self.free] = free
        return wp.array(batch, dtype=wp.vec3d, device=self.model.device)

    def _batches(self, free: np.ndarray) -> Sequence[np.ndarray]:
        size = self.model.env_count
        return [free[i : i + size] for i in range(0, len(free), size)]

    def energy(self, free: np.ndarray) -> np.ndarray:
        """[count]."""
        return np.concatenate(
            [
                self.potential.energy(self.active, self.positions(b))[: len(b)]
                for b in self._batches(free)
            ]
        )

    def gradient(self, free: np.ndarray) -> np.ndarray:
        """[count, free_count, 3]."""
        found = []
        for b in self._batches(free):
            x = self.positions(b)
            out = wp.zeros_like(x)
            self.potential.add_gradient(self.active, x, out)
            found.append(out.numpy()[: len(b), self.free])
        return np.concatenate(found)

    def hessian(self, free: np.ndarray, mode: int) -> np.ndarray:
        """Of one configuration, shape [3 free_count, 3 free_count]."""
        system = empty_system(self.model)
        modes = wp.full(self.model.env_count, mode, dtype=wp.int32, device=self.model.device)
        self.potential.add_hessian(self.active, self.positions(free[None]), system, modes)
        return dense(self.model, system)[0]


def differences(function: Any, free: np.ndarray, step: float) -> np.ndarray:
    """Central differences of a batched function by each coordinate, shape [3 free_count, ...]."""
    n = free.size
    moves = step * np.eye(n).reshape(n, *free.shape)
    values = function(np.concatenate([free + moves, free - moves]))
    return (values[:n] - values[n:]) / (2 * step)
