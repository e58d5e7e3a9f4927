# SPDX-License-Identifier: Apache-2.0
"""Direct solution of small systems, one environment after the other, on the host.

For scenes of affine bodies on the CPU: their stiffness is 1e5 times their inertia and more, which
costs CG many iterations, while the whole matrix of a few dozen bodies factors in milliseconds.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.problem import LinearProblem


class DenseCholesky:
    """Solver of H p = rhs by a dense Cholesky factorisation with one step of refinement."""

    description = "dense Cholesky: stiff bodies and few rows"
    capturable = False

    def __init__(self, problem: LinearProblem) -> None:
        self._problem = problem

    def solve(self, active: wp.array, max_iterations: int) -> None:
        """See ``LinearSystem.solve``; reports one iteration, whatever the tolerance."""
        from scipy.linalg import LinAlgError, cho_factor, cho_solve

        problem = self._problem
        extra = problem.extra
        running = active.numpy() != 0
        b = problem.rhs.numpy().reshape(len(running), -1)
        x = np.zeros_like(b)
        ratio, broken = np.zeros(len(running)), np.zeros(len(running), dtype=bool)
        blocks = problem.values.numpy()
        for env in np.flatnonzero(running):
            size = np.linalg.norm(b[env])
            if size == 0:
                continue
            matrix = problem.pattern.dense(blocks[env : env + 1])[0]
            _add_extra(matrix, extra.of(int(env), extra.places), extra.of(int(env), extra.values))
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
        problem.solution.assign(x.reshape((*problem.shape, 3)))
        problem.iterations.assign((running & ~broken).astype(np.int32))
        problem.residuals.assign(ratio)
        problem.breakdown.assign(broken.astype(np.int32))


def _add_extra(matrix: np.ndarray, places: np.ndarray, values: np.ndarray) -> None:
    """Add a list of blocks (row > column) and their mirror images to a dense matrix."""
    n = len(matrix) // 3
    grid = matrix.reshape(n, 3, n, 3).transpose(0, 2, 1, 3)
    np.add.at(grid, (places[:, 0], places[:, 1]), values)
    np.add.at(grid, (places[:, 1], places[:, 0]), np.swapaxes(values, -1, -2))
