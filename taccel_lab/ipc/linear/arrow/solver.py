# SPDX-License-Identifier: Apache-2.0
"""Direct solution of small gels in block-arrow form, one thread block an environment.

One kernel copies the matrix, factors it and solves, in shared memory where a block has room for the
factor (``Placement``). The factor is that of the whole matrix unless gels touch each other. Without
such extra blocks its solution is taken as it is: one iteration, and a residual that is reported as
zero because nobody multiplies it out. With them CG makes up for what the factor leaves out, and
only then the matrix is laid out for products.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.device.block_ops import MAX_LANES, Team, launch_team, team
from taccel_lab.ipc.linear.arrow.elimination import border_codes
from taccel_lab.ipc.linear.arrow.kernel import ArrowLists, ArrowWork, solve_kernel
from taccel_lab.ipc.linear.arrow.program import Placement, plan_arrow
from taccel_lab.ipc.linear.problem.arrays import LinearProblem
from taccel_lab.ipc.linear.problem.extra_rows import ExtraRowLists
from taccel_lab.ipc.linear.problem.packed_rows import row_slices
from taccel_lab.ipc.linear.problem.row_plan import RowPlan, scalars
from taccel_lab.ipc.linear.problem.turned import reach_m
from taccel_lab.model.env_lists import EnvMask
from taccel_lab.model.matrix_pattern import BlockPattern

MAX_ROWS = 400
"""Rows up to which the gels of an environment are factored."""


def holds(pattern: BlockPattern, clusters: list[tuple[int, int]]) -> bool:
    """Whether the method is for systems of this pattern."""
    few = pattern.free_count <= MAX_ROWS
    return few and plan_arrow(pattern, clusters, 0, hastes=[0.0])[1].addressable


def _lanes(device: wp.Device, env_count: int, placement: Placement) -> int:
    """Lanes of a block: 512 fill the registers of a multiprocessor, so that blocks are smaller
    where there are enough of them, and memory, to work side by side."""
    if device.is_cpu:
        return 1
    beside = 4
    if placement.room:
        # A chip has one KiB more than its largest block, and takes one of each block.
        beside = (device.max_shared_memory_per_block + 1024) // (placement.shared_bytes + 1024)
    beside = min(beside, -(-env_count // device.sm_count))
    return MAX_LANES // (1 if beside < 2 else 2 if beside < 4 else 4)


class Arrow:
    """Block-arrow factor, one thread block an environment."""

    def __init__(
        self,
        problem: LinearProblem,
        clusters: list[tuple[int, int]],
        lanes: int | None = None,
        limit_bytes: int | None = None,
    ) -> None:
        """``clusters``: ranges of rows of affine bodies, which become the border. ``lanes`` of the
        thread block and the shared memory that it may have are those of the device when left out.
        Raises ``InputError`` unless ``holds``."""
        self._problem = problem
        device, n = problem.device, problem.pattern.free_count
        if not holds(problem.pattern, clusters):
            raise InputError(
                f"linear_method arrow is for up to {MAX_ROWS} rows with few neighbours each, this "
                f"scene has {n:,}; use another, such as cg on a GPU or ssor on the CPU"
            )
        if limit_bytes is None:
            limit_bytes = int(device.max_shared_memory_per_block)
        plan, program = plan_arrow(problem.pattern, clusters, limit_bytes)
        many = device.is_cuda and problem.env_count > device.sm_count
        self._placement = placement = program.placement(limit_bytes, beside=many)
        self._kernel = solve_kernel(placement.room, placement.words_inside)
        order = np.concatenate([plan.order, plan.border])
        places = np.empty(n, dtype=np.int64)
        places[order] = np.arange(n)
        numbers = np.full(n, -1)
        numbers[plan.border] = np.arange(len(plan.border))
        self._reach = reach_m(problem, clusters)
        self._layout = program.layout
        self._lists = lists = ArrowLists()
        for name, array in (
            ("order", order),
            ("codes", plan.codes),
            ("program", program.words),
            ("border_codes", border_codes(problem.pattern, plan.border)),
            ("border_places", numbers),
            ("places", places),
        ):
            setattr(lists, name, wp.array(array.astype(np.int32), dtype=wp.int32, device=device))
        rows = RowPlan(order, places, np.zeros(0, dtype=np.int64), np.array([0, n]))
        self._values = scalars(problem.values)
        self._slices = row_slices(problem, rows)
        self._extra = ExtraRowLists(problem, rows, lanes, in_slices=False)
        lanes = lanes or _lanes(device, problem.env_count, placement)
        self._team = Team(team(device, problem.env_count, 3 * n, lanes).lanes)
        self._allocate()
        self.description = (
            f"block-arrow Cholesky in {placement}, {plan.block_count:,} blocks in "
            f"{program.layout.level_count} levels, {self._team.lanes} threads an environment"
        )

    def _allocate(self) -> None:
        problem = self._problem
        device, envs = problem.device, problem.env_count
        work = self._work = ArrowWork()
        work.numbers = wp.zeros((1, 1), dtype=wp.float64, device=device)
        if not self._placement.room:
            shape = (envs, self._layout.words)
            work.numbers = problem.scratch.take(shape, wp.float64, device)
        work.p = wp.zeros(problem.shape, dtype=wp.vec3d, device=device)
        work.p_scalars = scalars(work.p)
        dots = 2 * self._team.lanes if device.is_cpu else 1
        work.dots = wp.zeros((envs, dots), dtype=wp.vec3d, device=device)
        work.gates = wp.zeros(1, dtype=wp.int32, device=device)
        shape = (envs, self._slices.segment_count)
        work.parts = wp.zeros(shape, dtype=wp.vec3d, device=device)
        work.parts_scalars = scalars(work.parts)

    def solve(self, active: EnvMask, max_iterations: int) -> None:
        """See ``LinearSystem.solve``; residuals of exact solutions read 0."""
        problem = self._problem
        self._extra.update(active)
        inputs = [self._team.lanes, active, self._lists, self._layout, self._slices, self._values]
        inputs += [problem.extra.counts, self._extra.rows, problem.extra.places, self._extra.values]
        inputs += [problem.rhs, problem.tolerances, max_iterations, wp.float64(self._reach)]
        inputs += [self._work, problem.solution]
        inputs += [problem.iterations, problem.residuals, problem.breakdown]
        launch_team(self._kernel, problem.env_count, self._team, *inputs)
