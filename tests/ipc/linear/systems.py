# SPDX-License-Identifier: Apache-2.0
"""Newton-like systems on the pattern of a small tet mesh."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.pattern import BlockPattern, block_pattern
from taccel_lab.ipc.linear.report import LinearReport
from taccel_lab.ipc.linear.system import LinearSystem

BACKENDS = ("ssor", "cg", "pipelined")


def delaunay_pattern(rng: np.random.Generator, node_count: int, bonded: int) -> BlockPattern:
    """Pattern of a Delaunay mesh of random points, the first ``bonded`` of them without rows."""
    from scipy.spatial import Delaunay

    tets = Delaunay(rng.random((node_count, 3))).simplices
    free_index = np.arange(node_count, dtype=np.int32) - bonded
    return block_pattern([tets], np.maximum(free_index, -1))[0]


def random_spd(rng: np.random.Generator, pattern: BlockPattern, stiffness: float) -> np.ndarray:
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


def solve_batch(
    pattern: BlockPattern,
    values: np.ndarray,
    rhs: np.ndarray,
    active: np.ndarray,
    tolerance: float | np.ndarray,
    max_iterations: int = 2000,
    backend: str = "ssor",
    clusters: list[tuple[int, int]] | None = None,
) -> tuple[np.ndarray, LinearReport]:
    """Solutions [env_count, free_count, 3] and the report."""
    device = wp.get_device("cpu")
    system = LinearSystem(pattern, len(values), device, clusters=clusters, method=backend)
    system.values.assign(values)
    system.rhs.assign(rhs)
    system.tolerances.assign(np.broadcast_to(np.asarray(tolerance, float), len(values)).copy())
    # What an earlier solve left behind must not matter.
    system.solution.fill_(wp.vec3d(7.0))
    for array in (system.iterations, system.breakdown):
        array.fill_(7)
    system.residuals.fill_(np.nan)
    flags = wp.array(active.astype(np.int32), dtype=wp.int32, device=device)
    system.solve(flags, max_iterations)
    return system.solution.numpy(), system.report()
