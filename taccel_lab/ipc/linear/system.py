# SPDX-License-Identifier: Apache-2.0
"""The Newton systems H p = rhs of all environments and the solver that suits the device."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Protocol

import numpy as np
import warp as wp

from taccel_lab.ipc.device.block_ops import team
from taccel_lab.ipc.linear.cpu import SsorCG
from taccel_lab.ipc.linear.problem.arrays import LinearProblem, LinearReport
from taccel_lab.model.env_lists import EnvMask
from taccel_lab.model.launches import Scratch
from taccel_lab.model.matrix_pattern import BlockPattern


class Solver(Protocol):
    """What ``LinearSystem`` needs of a method."""

    description: str

    def solve(self, active: EnvMask, max_iterations: int) -> None:
        """See ``LinearSystem.solve``."""
        ...


class LinearSystem(LinearProblem):
    """Matrix blocks, right-hand sides and solutions, with their solver."""

    def __init__(
        self,
        pattern: BlockPattern,
        env_count: int,
        device: wp.Device,
        clusters: list[tuple[int, int]] | None = None,
        method: str = "auto",
        extra_room: int = 1,
        scratch: Scratch | None = None,
        positions_m: np.ndarray | None = None,
        held: np.ndarray | None = None,
        in_any_order: bool = False,
    ) -> None:
        """``clusters``: ranges (first, end) of rows that are stiff among themselves, as the control
        nodes of an affine body. ``method``: "auto" or one of ``METHODS``. ``extra_room``: blocks of
        an environment that ``ExtraBlocks`` has room for at first. ``scratch``: memory that is free
        during a solve. ``positions_m``: of the rows at rest [m], shape [free_count, 3].
        ``held``, ``in_any_order``: see ``LinearProblem``.
        """
        super().__init__(
            pattern, env_count, device, extra_room, scratch, positions_m, held, in_any_order
        )
        self.clusters = list(clusters or [])
        if method == "auto":
            method = _method(pattern, self.clusters, env_count, device)
        self.method = method
        """The one of ``METHODS`` that solves."""
        # It is part of this and must not keep it alive: a circle of arrays, hundreds of megabytes,
        # would wait for the cycle collector.
        self._solver = METHODS[method](weakref.proxy(self))

    def describe(self) -> str:
        """Method, rows and stored blocks of one environment, for people."""
        p = self.pattern
        return f"{self._solver.description}; {p.free_count:,} rows, {p.block_count:,} blocks"

    def solve(self, active: EnvMask, max_iterations: int) -> None:
        """Solve to ||rhs - H p|| <= tolerances ||rhs|| in each active environment, on a GPU with H
        rounded to single precision where tolerances are no tighter than ``VERIFY_BELOW``.

        ``active``: int32, shape [env_count]. ``values`` and ``rhs`` are left as they are, and so is
        the matrix, but extra blocks of one place are summed in the list. Written are ``solution``,
        ``iterations``, ``breakdown`` and ``residuals``.
        """
        self._solver.solve(active, max_iterations)

    def report(self) -> LinearReport:
        """Figures of the last solve on the host; waits for the device."""
        return LinearReport.read(self)


_LONG = 2**31 - 1
"""Clock cycles, about a second, for which a team waits for all its members where bits count: fewer
thread blocks add up in another order."""

# Warp reads the kernels of a module when that is imported: those of GPUs, which are most, are
# imported where one is used.


def _ssor(system: LinearSystem) -> Solver:
    return SsorCG(system, system.clusters)


def _block_cg(system: LinearSystem) -> Solver:
    from taccel_lab.ipc.linear.cg.block_cg import BlockCG

    return BlockCG(system, system.clusters)


def _arrow(system: LinearSystem) -> Solver:
    from taccel_lab.ipc.linear.arrow.solver import Arrow

    return Arrow(system, system.clusters)


def _pipelined_cg(system: LinearSystem) -> Solver:
    from taccel_lab.ipc.linear.cg.pipelined_cg import PATIENCE, PipelinedCG

    patience = _LONG if system.in_any_order else PATIENCE
    return PipelinedCG(system, system.clusters, patience=patience)


METHODS: dict[str, Callable[[LinearSystem], Solver]] = {
    "ssor": _ssor,
    "cg": _block_cg,
    "arrow": _arrow,
    "pipelined": _pipelined_cg,
}


def _method(
    pattern: BlockPattern, clusters: list[tuple[int, int]], env_count: int, device: wp.Device
) -> str:
    """The solver that suits device and size; docs/evidence/ablations.md has the times of each."""
    if device.is_cpu:
        # Gauss-Seidel sweeps run along the rows: quick on one CPU thread, hopeless on thousands.
        return "ssor"
    from taccel_lab.ipc.linear.arrow.solver import holds
    from taccel_lab.ipc.linear.cg.pipelined_cg import TASKS_PER_ROW

    if holds(pattern, clusters):
        return "arrow"
    # Several thread blocks an environment where one would have more than it can do at a time.
    blocks = team(device, env_count, TASKS_PER_ROW * pattern.free_count).blocks
    return "cg" if blocks == 1 else "pipelined"
