# SPDX-License-Identifier: Apache-2.0
"""Energies, gradients and matrices of a potential as numpy arrays, against central differences."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.problem.arrays import ExtraBlocks
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.model import Model

Array = np.ndarray


def differences(
    function: Callable[[Array], Array], x: Array, step: float, some: Any = slice(None)
) -> Array:
    """By (some of) the coordinates of ``x``, of a function of configurations, [coordinate, ...]."""
    moves = step * np.eye(x.size)[some].reshape(-1, *x.shape)
    values = function(np.concatenate([x + moves, x - moves]))
    return (values[: len(moves)] - values[len(moves) :]) / (2 * step)


def assert_derivatives(
    x: Array,
    step: float,
    energy: Callable[[Array], Array],
    gradient: Callable[[Array], Array],
    matrix: Array,
    free: Any = slice(None),
    least: tuple[float, float] = (0.0, 0.0),
    within: tuple[float, float] = (1e-6, 1e-6),
) -> Array:
    """Check ``gradient`` at ``x`` [node, 3] against ``energy``, ``matrix`` against ``gradient``.

    Both take configurations [6 node, node, 3]; the matrix is that of the ``free`` nodes, and is
    symmetric. The largest entries of gradient and matrix are above ``least``, and right to the
    parts ``within`` of them. Returns d gradient / d x of all nodes, [node, 3, free, 3].
    """
    found = gradient(np.repeat(x[None], 2 * x.size, axis=0))[0]
    assert np.abs(found).max() > least[0]
    slope = differences(energy, x, step).reshape(found.shape)
    np.testing.assert_allclose(found, slope, atol=within[0] * np.abs(found).max())
    change = differences(gradient, x, step).reshape(*x.shape, *x.shape)[..., free, :]
    expected = change[free].reshape(matrix.shape)
    scale = np.abs(expected).max()
    assert scale > least[1]
    np.testing.assert_allclose(matrix, expected, atol=within[1] * scale)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
    return change


def assert_semidefinite(matrix: Array) -> None:
    assert np.linalg.eigvalsh(matrix)[0] > -1e-12 * np.abs(matrix).max()


def empty_system(model: Model) -> NewtonSystem:
    """A Newton system whose pattern holds every block of the lower triangle."""
    n, env_count = model.free_count, model.env_count
    rows = np.arange(n)
    system = NewtonSystem()
    for name in ("free_index", "parents", "weights"):
        setattr(system, name, getattr(model, name))
    system.row_starts = wp.array(np.cumsum([0, *(rows + 1)]), dtype=wp.int32)
    system.columns = wp.array(np.tril_indices(n)[1], dtype=wp.int32)
    system.values = wp.zeros((env_count, n * (n + 1) // 2), dtype=wp.mat33d)
    extra = ExtraBlocks(env_count, model.device, 0)
    system.extra_room, system.extra_places = extra.room, extra.places
    system.extra_values = extra.values
    system.rhs = wp.zeros((env_count, n), dtype=wp.vec3d)
    system.displacements = wp.zeros((env_count, model.node_count), dtype=wp.vec3d)
    return system


class Dense:
    """A potential evaluated in any number of configurations of the free nodes.

    Configurations [count, free_count, 3] are dealt out to the environments of the model.
    """

    def __init__(self, model: Model, potential: Any, base: Array) -> None:
        self.model, self.potential = model, potential
        self.base = base
        self.free = model.free_nodes.numpy()
        self.active = wp.full(model.env_count, 1, dtype=wp.int32, device=model.device)

    def positions(self, free: Array) -> wp.array:
        """Node positions of a batch, padded to the number of environments."""
        batch = np.repeat(self.base[None], self.model.env_count, axis=0)
        batch[: len(free), self.free] = free
        return wp.array(batch, dtype=wp.vec3d, device=self.model.device)

    def batches(self, free: Array) -> Iterator[tuple[int, wp.array]]:
        """Number and positions of configurations, as many at a time as there are environments."""
        size = self.model.env_count
        for first in range(0, len(free), size):
            part = free[first : first + size]
            yield len(part), self.positions(part)

    def energy(self, free: Array) -> Array:
        found = [self.potential.energy(self.active, x)[:n] for n, x in self.batches(free)]
        return np.concatenate(found)

    def gradient(self, free: Array) -> Array:
        found = []
        for n, x in self.batches(free):
            out = wp.zeros_like(x)
            self.potential.add_gradient(self.active, x, out)
            found.append(out.numpy()[:n, self.free])
        return np.concatenate(found)

    def hessian(self, free: Array, mode: int) -> Array:
        system, n = empty_system(self.model), self.model.free_count
        modes = wp.full(self.model.env_count, mode, dtype=wp.int32, device=self.model.device)
        self.potential.add_hessian(self.active, self.positions(free[None]), system, modes)
        full = np.zeros((n, n, 3, 3))
        rows, columns = np.tril_indices(n)
        values = system.values.numpy()[0]
        full[columns, rows] = np.swapaxes(values, -1, -2)
        full[rows, columns] = values
        return full.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)
