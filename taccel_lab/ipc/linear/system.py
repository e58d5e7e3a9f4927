# SPDX-License-Identifier: Apache-2.0
"""The Newton systems H p = rhs of all environments and the solver that suits the device."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.dense_cholesky import DenseCholesky
from taccel_lab.ipc.linear.extra_blocks import ExtraBlocks
from taccel_lab.ipc.linear.pattern import BlockPattern
from taccel_lab.ipc.linear.pcg import BlockJacobiCG
from taccel_lab.ipc.linear.report import LinearReport
from taccel_lab.ipc.linear.ssor_cg import SsorCG

MAX_DIRECT_ROWS = 400
"""Rows up to which a stiff system is factored: 1,200 unknowns take about 30 ms on one core."""


class LinearSystem:
    """Matrix blocks, right-hand sides and solutions, with their solver."""

    def __init__(
        self, pattern: BlockPattern, env_count: int, device: wp.Device, stiff: bool = False
    ) -> None:
        """``stiff``: whether most of the unknowns are those of affine bodies."""
        self.values = wp.zeros((env_count, pattern.block_count), dtype=wp.mat33d, device=device)
        """Blocks of the lower triangle [N/m], shape [env_count, block_count]."""
        self.extra = ExtraBlocks(env_count, device)
        """What does not fit the pattern."""
        shape = (env_count, pattern.free_count)
        self.rhs = wp.zeros(shape, dtype=wp.vec3d, device=device)
        """Right-hand sides [N], shape [env_count, free_count]."""
        self.solution = wp.zeros(shape, dtype=wp.vec3d, device=device)
        """Solutions [m], shape [env_count, free_count]; zero where not active."""
        self._tolerances = wp.zeros(env_count, dtype=wp.float64, device=device)
        # Gauss-Seidel sweeps run along the rows: quick on one CPU thread, hopeless on thousands.
        solver = SsorCG if device.is_cpu else BlockJacobiCG
        if stiff and device.is_cpu and pattern.free_count <= MAX_DIRECT_ROWS:
            solver = DenseCholesky
        self._solver = solver(pattern, env_count, device)
        self._pattern = pattern

    def describe(self) -> str:
        """Method, rows and stored blocks of one environment, for people."""
        method = {
            SsorCG: "CG with symmetric Gauss-Seidel, one kernel",
            BlockJacobiCG: "CG with block Jacobi, all environments at once",
            DenseCholesky: "dense Cholesky: stiff bodies and few rows",
        }[type(self._solver)]
        return f"{method}; {self._pattern.free_count:,} rows, {self._pattern.block_count:,} blocks"

    def solve(
        self, active: wp.array, relative_tolerance: float | np.ndarray, max_iterations: int
    ) -> LinearReport:
        """Solve to ||rhs - H p|| <= relative_tolerance ||rhs|| in each active environment.

        ``active``: int32, shape [env_count]. ``relative_tolerance``: one number or one an
        environment. ``values`` and ``rhs`` are left as they are.
        """
        tolerances = np.broadcast_to(
            np.asarray(relative_tolerance, dtype=np.float64), self._tolerances.shape
        )
        self._tolerances.assign(np.ascontiguousarray(tolerances))
        return self._solver.solve(
            self.values,
            self.extra,
            self.rhs,
            self.solution,
            active,
            self._tolerances,
            max_iterations,
        )
