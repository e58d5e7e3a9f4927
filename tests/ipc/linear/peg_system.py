# SPDX-License-Identifier: Apache-2.0
"""A Newton-like system of two gels and a body between them.

Linear elasticity and inertia on boxes of tets whose bottom is bonded; both touch one body of four
control nodes, whose couplings come as a list with repeated places, as assembly writes them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.model.matrix_pattern import BlockPattern, block_pattern
from tests.ipc.linear.systems import add_extra, list_extra

YOUNG_PA = 1.5e5
POISSON = 0.46
DENSITY = 1e3
DT_S = 0.02


@dataclass
class System:
    """One environment's H p = rhs."""

    pattern: BlockPattern
    values: np.ndarray
    """[block_count, 3, 3]."""
    rhs: np.ndarray
    """[free_count, 3]."""
    places: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int32))
    """(row, column) of extra blocks, [extra_count, 2]."""
    blocks: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    """Extra blocks, [extra_count, 3, 3]."""
    clusters: list[tuple[int, int]] = field(default_factory=list)

    def dense(self) -> np.ndarray:
        """Both triangles with the extra blocks."""
        matrix = self.pattern.dense(self.values[None])[0]
        add_extra(matrix, self.places, self.blocks)
        return matrix


def box_tets(
    shape: tuple[int, int, int], size: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [n, 3] of a grid of ``shape`` nodes, the bottom layer first, and its tets, six a
    cell."""
    axes = [np.linspace(0.0, length, count) for length, count in zip(size, shape, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    nodes = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    strides = np.array([1, shape[0], shape[0] * shape[1]])
    cells = np.stack(np.meshgrid(*(np.arange(n - 1) for n in shape), indexing="ij"), -1)
    corner = cells.reshape(-1, 3) @ strides
    orders = [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)]
    tets = [corner[:, None] + np.cumsum([0, *strides[list(order)]]) for order in orders]
    return nodes, np.concatenate(tets)


def elastic_blocks(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Stiffness [N/m] with inertia of each tet, [tet, 4, 4, 3, 3]."""
    edges = nodes[tets[:, 1:]] - nodes[tets[:, :1]]
    volume = np.abs(np.linalg.det(edges)) / 6
    inner = np.linalg.inv(edges).transpose(0, 2, 1)
    gradients = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    shear = YOUNG_PA / (2 * (1 + POISSON))
    lame = YOUNG_PA * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    outer = np.einsum("tai,tbj->tabij", gradients, gradients)
    dots = np.einsum("tai,tbi->tab", gradients, gradients)
    blocks = lame * outer + shear * outer.transpose(0, 1, 2, 4, 3)
    blocks += shear * dots[..., None, None] * np.eye(3)
    blocks *= volume[:, None, None, None, None]
    mass = DENSITY * volume / 4 / DT_S**2
    for a in range(4):
        blocks[:, a, a] += mass[:, None, None] * np.eye(3)
    return blocks


def assemble(
    pattern: BlockPattern, tets: np.ndarray, free: np.ndarray, blocks: np.ndarray
) -> np.ndarray:
    keys = pattern.rows.astype(np.int64) * pattern.free_count + pattern.columns
    values = np.zeros((pattern.block_count, 3, 3))
    for a in range(4):
        for b in range(4):
            row, column = free[tets[:, a]], free[tets[:, b]]
            keep = (row >= column) & (column >= 0)
            key = row[keep].astype(np.int64) * pattern.free_count + column[keep]
            np.add.at(values, np.searchsorted(keys, key), blocks[keep, a, b])
    return values


def peg(seed: int = 0, contacts: int = 160) -> System:
    """Two gels of 160 nodes, half of them free, with a body of four control nodes between them."""
    rng = np.random.default_rng(seed)
    nodes, tets = box_tets((10, 8, 2), (20e-3, 25e-3, 4e-3))
    count = len(nodes)
    free = np.concatenate([np.maximum(np.arange(count) - 80, -1)] * 2)
    free[count:][free[count:] >= 0] += 80
    free = np.concatenate([free, 160 + np.arange(4)])
    groups = [tets, tets + count, 2 * count + np.arange(4)[None]]
    pattern = block_pattern(groups, free)
    elastic = elastic_blocks(nodes, tets)
    values = assemble(
        pattern, np.concatenate([tets, tets + count]), free, np.concatenate([elastic, elastic])
    )
    keys = pattern.rows.astype(np.int64) * pattern.free_count + pattern.columns
    # 1e9 Pa of a cubic centimetre against a change of shape, a mass of 20 g against all motion.
    root = rng.normal(size=(12, 6))
    body = 1e5 * root @ root.T + np.kron(np.diag([1.0, 0.2, 0.2, 0.2]), 50 * np.eye(3))
    i, j = np.tril_indices(4)
    own = np.searchsorted(keys, (160 + i) * pattern.free_count + 160 + j)
    values[own] += body.reshape(4, 3, 4, 3).transpose(0, 2, 1, 3)[i, j]
    places, blocks = [], []
    patch = np.concatenate([30 + np.arange(26), 110 + np.arange(26)])
    for _ in range(contacts):
        gel = rng.choice(patch, 3, replace=False)
        shares = rng.dirichlet(np.ones(3))
        weights = rng.dirichlet(np.ones(4))
        normal = rng.normal(size=3) * [0.1, 0.1, 1.0]
        normal /= np.linalg.norm(normal)
        block = 10.0 ** rng.uniform(1, 4) * np.outer(normal, normal)
        rows = [*gel, *(160 + np.arange(4))]
        scales = [*shares, *(-weights)]
        for i, s in zip(rows, scales, strict=True):
            for j, t in zip(rows, scales, strict=True):
                if i < j:
                    continue
                fits = np.searchsorted(keys, i * pattern.free_count + j)
                if fits < len(keys) and keys[fits] == i * pattern.free_count + j:
                    values[fits] += s * t * block
                elif j < 160 <= i:
                    places.append((i, j))
                    blocks.append(s * t * block)
                else:
                    # Nodes of one face share an element: put what does not on the diagonal.
                    values[pattern.diagonal[i]] += abs(s * t) * block
                    values[pattern.diagonal[j]] += abs(s * t) * block
    return System(
        pattern,
        values,
        1e-4 * rng.normal(size=(pattern.free_count, 3)),
        np.array(places, dtype=np.int32),
        np.array(blocks),
        [(160, 164)],
    )


def with_contact_in_pattern(system: System) -> System:
    """The same matrix with blocks between the clusters and all other rows in its pattern, as
    scenes on a GPU have it, and no list."""
    p = system.pattern
    n = p.free_count
    keys = np.union1d(
        p.rows.astype(np.int64) * n + p.columns,
        np.concatenate(
            [row * n + np.arange(row + 1) for span in system.clusters for row in range(*span)]
        ),
    )
    rows, columns = np.divmod(keys, n)
    pattern = BlockPattern(
        np.searchsorted(rows, np.arange(n + 1)).astype(np.int32),
        columns.astype(np.int32),
        np.flatnonzero(rows == columns).astype(np.int32),
    )
    values = np.zeros((len(keys), 3, 3))
    values[np.searchsorted(keys, p.rows.astype(np.int64) * n + p.columns)] = system.values
    own = system.places[:, 0].astype(np.int64) * n + system.places[:, 1]
    np.add.at(values, np.searchsorted(keys, own), system.blocks)
    return System(pattern, values, system.rhs, clusters=system.clusters)


def build(system: System, env_count: int, device: wp.Device) -> LinearSystem:
    """The system in ``env_count`` environments: s H p = s^2 rhs with its factor s, so that a
    mix-up of environments shows."""
    clusters = system.clusters
    linear = LinearSystem(system.pattern, env_count, device, clusters=clusters, method="cg")
    scales = scale_factors(env_count)[:, None, None]
    linear.values.assign(scales[..., None] * system.values)
    linear.rhs.assign(scales**2 * system.rhs)
    if len(system.places):
        blocks = [scale * system.blocks for scale in scales]
        list_extra(linear.extra, env_count * [system.places], blocks)
    return linear


def scale_factors(env_count: int) -> np.ndarray:
    """Factor s of each environment; its solution is s times that of the system."""
    return np.linspace(1.0, 2.0, env_count)
