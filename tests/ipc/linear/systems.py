# SPDX-License-Identifier: Apache-2.0
"""Newton-like systems on the pattern of a small tet mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.problem.arrays import ExtraBlocks, LinearReport
from taccel_lab.ipc.linear.problem.turned import LEAST_TURNED
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.model.matrix_pattern import BlockPattern, block_pattern

Array = np.ndarray
BACKENDS = ("ssor", "cg", "pipelined", "arrow")


def delaunay_pattern(rng: np.random.Generator, node_count: int, bonded: int) -> BlockPattern:
    """Pattern of a Delaunay mesh of random points, the first ``bonded`` of them without rows."""
    from scipy.spatial import Delaunay

    tets = Delaunay(rng.random((node_count, 3))).simplices
    free_index = np.arange(node_count, dtype=np.int32) - bonded
    return block_pattern([tets], np.maximum(free_index, -1))


def random_spd(rng: np.random.Generator, pattern: BlockPattern, stiffness: float) -> Array:
    """Blocks of a network of springs, a few of them stiff as contacts, with a soft foundation.

    Shape [block_count, 3, 3]. Larger ``stiffness`` makes the matrix worse conditioned.
    """
    values = np.zeros((pattern.block_count, 3, 3))
    values[pattern.diagonal] += 1e-2 * np.eye(3)
    for block, (row, column) in enumerate(zip(pattern.rows, pattern.columns, strict=True)):
        if row == column:
            continue
        root = rng.normal(size=(3, 3))
        spring = root @ root.T * (stiffness if rng.random() < 0.05 else 1.0)
        # (S x_row - T x_column)^2 with an unsymmetric coupling block, as in a deformed gel.
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        values[pattern.diagonal[row]] += spring
        values[pattern.diagonal[column]] += turn.T @ spring @ turn
        values[block] -= spring @ turn
    return values


def list_extra(extra: ExtraBlocks, places: Sequence[Sequence], blocks: Sequence[Sequence]) -> None:
    """List (row, column) and blocks, with room to spare, in which nothing must matter."""
    counts = np.array([len(part) for part in places])
    extra.counts.zero_()
    extra._allocate(counts + 3 + 2 * np.arange(len(counts)))
    all_places = np.zeros((extra.capacity, 2), dtype=np.int32)
    all_blocks = np.full((extra.capacity, 3, 3), np.nan)
    for start, where, what in zip(extra.starts.numpy()[:-1], places, blocks, strict=True):
        all_places[start : start + len(where)] = np.reshape(where, (-1, 2))
        all_blocks[start : start + len(where)] = np.reshape(what, (-1, 3, 3))
    extra.places.assign(all_places)
    extra.values.assign(all_blocks)
    extra.counts.assign(counts.astype(np.int32))


def contact_system(
    envs: int, contacts: int = 40, bodies: int = 1, on: str = "cpu"
) -> tuple[LinearSystem, Array]:
    """A gel and stiff bodies of four rows each, which come last, and the dense matrices.

    ``contacts`` faces of the gel touch the last body: a list of extra blocks, places repeated.
    """
    rng = np.random.default_rng(0)
    gel = delaunay_pattern(rng, 60, bonded=5)
    n = gel.free_count + 4 * bodies
    firsts = np.arange(gel.free_count, n, 4)
    i, j = np.tril_indices(4)
    rows = np.concatenate([gel.rows, *(first + i for first in firsts)])
    columns = np.concatenate([gel.columns, *(first + j for first in firsts)])
    starts = np.searchsorted(rows, np.arange(n + 1)).astype(np.int32)
    pattern = BlockPattern(starts, columns.astype(np.int32), (starts[1:] - 1).astype(np.int32))
    clusters = [(int(first), int(first) + 4) for first in firsts]
    system = LinearSystem(pattern, envs, wp.get_device(on), clusters=clusters, method="cg")
    values = np.zeros((envs, pattern.block_count, 3, 3))
    places: list[list] = [[] for _ in range(envs)]
    extras: list[list] = [[] for _ in range(envs)]
    for env in range(envs):
        values[env, : gel.block_count] = random_spd(rng, gel, 30.0)
        for b in range(bodies):
            root = 1e3 * rng.normal(size=(12, 12)) * (np.arange(12) < 8)
            stiff = (root @ root.T + 10 * np.eye(12)).reshape(4, 3, 4, 3).transpose(0, 2, 1, 3)
            values[env, gel.block_count + 10 * b :][:10] = stiff[i, j]
        for _ in range(contacts - 3 * env if bodies else 0):
            face = rng.choice(20, 2, replace=False)
            shares, weights = rng.dirichlet(np.ones(2)), -rng.dirichlet(np.ones(4))
            normal = rng.normal(size=3)
            block = 10.0 ** rng.uniform(0, 3) * np.outer(normal, normal)
            for node, share in zip(face, shares, strict=True):
                # What the two nodes share is left out, to keep to the pattern: stays definite.
                values[env, pattern.diagonal[node]] += share * block
                places[env] += [(n - 4 + k, node) for k in range(4)]
                extras[env] += [share * weight * block for weight in weights]
            values[env, -10:] += (weights[i] * weights[j])[:, None, None] * block
    system.values.assign(values)
    list_extra(system.extra, places, extras)
    system.rhs.assign(rng.normal(size=(envs, n, 3)))
    dense = pattern.dense(values)
    for env in range(envs):
        add_extra(dense[env], places[env], extras[env])
    assert np.linalg.eigvalsh(dense).min() > 0
    return system, dense


def add_extra(dense: Array, places: Sequence, blocks: Sequence) -> None:
    """Add blocks below the diagonal, and above it, to a matrix [3 n, 3 n]."""
    n = len(dense) // 3
    whole = dense.reshape(n, 3, n, 3)
    for (row, column), block in zip(places, blocks, strict=True):
        whole[row, :, column] += block
        whole[column, :, row] += np.transpose(block)


def touch_elsewhere(system: LinearSystem, dense: Array, bodies: int) -> None:
    """Add contacts that a ``contact_system`` of one environment lacks, to it and to ``dense``.

    They join two bodies where there are two, else nodes of the gel whose block the pattern lacks.
    """
    rng = np.random.default_rng(bodies)
    extra, matrix = system.extra, system.values.numpy()
    places, values = list(extra.of(0, extra.places)), list(extra.of(0, extra.values))
    n = system.pattern.free_count
    gels = n - 4 * bodies
    pairs = [(gels - 1, 0), (gels - 3, 2)] if bodies < 2 else [(n - 1, n - 7), (n - 3, n - 8)]
    for i, j in pairs:
        normal = rng.normal(size=3)
        block = 100 * np.outer(normal, normal)
        places.append(np.array([i, j]))
        values.append(-block)
        matrix[0, system.pattern.diagonal[[i, j]]] += block
        add_extra(dense[0], [(i, i), (j, j), (i, j)], [block / 2, block / 2, -block])
    system.values.assign(matrix)
    list_extra(extra, [places], [values])


def with_contact_in_pattern(system: LinearSystem, dense: Array) -> LinearSystem:
    """The same matrices with all blocks of the bodies' rows in the pattern, as scenes on a GPU have
    it, and no list."""
    n, gels = system.pattern.free_count, system.clusters[0][0]
    held = np.tril(np.ones((n, n), dtype=bool))
    held[:gels, :gels] = False
    held[system.pattern.rows, system.pattern.columns] = True
    rows, columns = np.nonzero(held)
    starts = np.searchsorted(rows, np.arange(n + 1)).astype(np.int32)
    pattern = BlockPattern(starts, columns.astype(np.int32), (starts[1:] - 1).astype(np.int32))
    other = LinearSystem(pattern, len(dense), system.device, clusters=system.clusters, method="cg")
    other.values.assign(dense.reshape(-1, n, 3, n, 3)[:, rows, :, columns].swapaxes(0, 1))
    other.rhs.assign(system.rhs)
    return other


def mask(*active: int, on: str = "cpu") -> wp.array:
    return wp.array(active, dtype=wp.int32, device=on)


def solve(
    system: LinearSystem,
    tolerance: float | Array,
    active: Sequence[int] | None = None,
    most: int = 1000,
) -> LinearReport:
    """The report of a solve of (active) environments; what was there before must not matter."""
    count = len(system.tolerances)
    system.tolerances.assign(np.full(count, tolerance))
    system.solution.fill_(wp.vec3d(np.nan))
    for array in (system.iterations, system.breakdown):
        array.fill_(7)
    system.residuals.fill_(np.nan)
    system.solve(mask(*([1] * count if active is None else active), on=str(system.device)), most)
    return system.report()


def residuals(system: LinearSystem, dense: Array, rhs: Array | None = None) -> Array:
    """Of each environment over its load, the right-hand side of the system when None."""
    rhs = system.rhs.numpy() if rhs is None else rhs
    load, x = (array.reshape(len(dense), -1) for array in (rhs, system.solution.numpy()))
    left = load - np.einsum("eij,ej->ei", dense, x)
    return np.linalg.norm(left, axis=1) / np.linalg.norm(load, axis=1)


def turned(matrix: Array, order: Array, gel_rows: int) -> Array:
    """The matrix whose factor, in this order of rows, has the other sign of negative pivots."""
    index = (3 * order[:, None] + np.arange(3)).ravel()
    rest, change = matrix[np.ix_(index, index)].copy(), np.zeros(len(matrix))
    for k in range(len(rest)):
        if k % 3 == 0:
            least = LEAST_TURNED * np.abs(np.diag(rest)[k : k + 3]).sum() * (k < 3 * gel_rows)
        if rest[k, k] < 0:
            change[index[k]] = max(-rest[k, k], least) - rest[k, k]
            rest[k, k] += change[index[k]]
        rest[k + 1 :, k + 1 :] -= np.outer(rest[k + 1 :, k], rest[k, k + 1 :]) / rest[k, k]
    return matrix + np.diag(change)


def system_of(
    pattern: BlockPattern,
    values: Array,
    rhs: Array,
    backend: str = "ssor",
    positions_m: Array | None = None,
) -> LinearSystem:
    device = wp.get_device("cpu")
    system = LinearSystem(pattern, len(values), device, method=backend, positions_m=positions_m)
    system.values.assign(values)
    system.rhs.assign(rhs)
    return system
