# SPDX-License-Identifier: Apache-2.0
"""Direct solution of small systems, one environment after the other, on the host.

For scenes of affine bodies on the CPU: their stiffness is 1e5 times their inertia and more, which
costs CG many iterations, while the whole matrix of a few dozen bodies factors in milliseconds.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.extra_blocks import ExtraBlocks
from taccel_lab.ipc.linear.pattern import BlockPattern
from taccel_lab.ipc.linear.report import LinearReport


class DenseCholesky:
    """Solver of H p = rhs by a dense Cholesky factorisation with one step of refinement."""

    def __init__(self, pattern: BlockPattern, env_count: int, device: wp.Device) -> None:
        self._pattern = pattern

    def solve(
        self,
        values: wp.array,
        extra: ExtraBlocks,
        rhs: wp.array,
        solution: wp.array,
        active: wp.array,
        tolerances: wp.array,
        max_iterations: int,
    ) -> LinearReport:
        """See ``LinearSystem.solve``; reports one iteration, whatever the tolerance."""
        from scipy.linalg import LinAlgError, cho_factor, cho_solve

        running = active.numpy() != 0
        b = rhs.numpy().reshape(len(running), -1)
        x = np.zeros_like(b)
        ratio, broken = np.zeros(len(running)), np.zeros(len(running), dtype=bool)
        blocks, places, extras = values.numpy(), extra.places.numpy(), extra.values.numpy()
        counts = extra.counts.numpy()
        for env in np.flatnonzero(running):
            size = np.linalg.norm(b[env])
            if size == 0:
                continue
            matrix = self._pattern.dense(blocks[env : env + 1])[0]
            _add_extra(matrix, places[env, : counts[env]], extras[env, : counts[env]])
            if not (np.isfinite(matrix).all() and np.isfinite(size)):
                broken[env] = True
                continue
            try:
                factor = cho_factor(matrix, lower=True)
            except LinAlgError:
                broken[env] = True
                continue
            x[env] = cho_solve(factor, b[env])
            x[env] += cho_solve(factor, b[env] - matrix @ x[env])
            ratio[env] = np.linalg.norm(b[env] - matrix @ x[env]) / size
        solution.assign(x.reshape(solution.shape + (3,)))
        return LinearReport(
            iterations=(running & ~broken).astype(np.int64),
            relative_residual=ratio,
            breakdown=broken,
        )


def _add_extra(matrix: np.ndarray, places: np.ndarray, values: np.ndarray) -> None:
    """Add a list of blocks (row > column) and their mirror images to a dense matrix."""
    n = len(matrix) // 3
    grid = matrix.reshape(n, 3, n, 3).transpose(0, 2, 1, 3)
    np.add.at(grid, (places[:, 0], places[:, 1]), values)
    np.add.at(grid, (places[:, 1], places[:, 0]), np.swapaxes(values, -1, -2))
