# SPDX-License-Identifier: Apache-2.0
"""Direct solution of small gels in block-arrow form: CG preconditioned by their exact factor.

One thread block an environment and one kernel. The factor (``arrow_factor``) is that of the whole
matrix, so that one iteration ends it, unless gels touch each other: blocks between two gel rows
outside of the pattern are not in the factor, and CG makes up for them.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.branches import side_by_side
from taccel_lab.ipc.linear.arrow_factor import (
    SCHUR_CHUNKS,
    SUM_CHUNKS,
    ArrowLists,
    factor_columns,
    invert_schur,
    load_matrix,
    solve_factored,
)
from taccel_lab.ipc.linear.block_ops import Team, block_barrier, launch_team, team, team_sum
from taccel_lab.ipc.linear.elimination import Elimination, border_codes, eliminate
from taccel_lab.ipc.linear.extra_rows import ExtraRowLists, ExtraRows
from taccel_lab.ipc.linear.packed_rows import PackedRows, RowSlices
from taccel_lab.ipc.linear.problem import LinearProblem
from taccel_lab.ipc.linear.row_lists import scalars
from taccel_lab.ipc.linear.row_plan import RowPlan
from taccel_lab.ipc.linear.row_products import multiply_extra, multiply_fixed, row_sum

wp.set_module_options({"enable_backward": False})


@wp.struct
class ArrowWork:
    """Vectors by places, [env_count, row_count], and the factor.

    factor: scalars of its blocks. roots: see ``factor_columns``. schur: two copies.
    parts: products of segments. sums: partial sums of the border. dots, gates: see ``team_sum``.
    """

    r: wp.array2d(dtype=wp.vec3d)
    z: wp.array2d(dtype=wp.vec3d)
    p: wp.array2d(dtype=wp.vec3d)
    parts: wp.array2d(dtype=wp.vec3d)
    r_scalars: wp.array2d(dtype=wp.float64)
    z_scalars: wp.array2d(dtype=wp.float64)
    p_scalars: wp.array2d(dtype=wp.float64)
    parts_scalars: wp.array2d(dtype=wp.float64)
    factor: wp.array2d(dtype=wp.float64)
    roots: wp.array2d(dtype=wp.mat33d)
    schur: wp.array2d(dtype=wp.float64)
    sums: wp.array2d(dtype=wp.float64)
    dots: wp.array2d(dtype=wp.vec3d)
    gates: wp.array(dtype=wp.int32)


@wp.kernel(grid_stride=False, launch_bounds=(512, 2))
def _factor_kernel(
    lanes: int,
    active: wp.array(dtype=wp.int32),
    lists: ArrowLists,
    values: wp.array2d(dtype=wp.float64),
    extra: ExtraRows,
    extra_places: wp.array(dtype=wp.vec2i),
    extra_values: wp.array(dtype=wp.float64),
    work: ArrowWork,
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    load_matrix(
        env,
        lane,
        lanes,
        lists,
        values[env],
        extra,
        extra_places,
        extra_values,
        work.factor[env],
    )
    factor_columns(lane, lanes, lists, work.factor[env], work.roots[env])
    if lists.border_count > 0:
        invert_schur(
            env,
            lane,
            lanes,
            lists,
            values[env],
            extra,
            extra_places,
            extra_values,
            work.factor[env],
            work.sums[env],
            work.schur[env],
        )


@wp.kernel(grid_stride=False, launch_bounds=(512, 2))
def _solve_kernel(
    lanes: int,
    active: wp.array(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
    lists: ArrowLists,
    layout: RowSlices,
    packed: wp.array2d(dtype=wp.float64),
    extra: ExtraRows,
    extra_values: wp.array(dtype=wp.float64),
    rhs: wp.array2d(dtype=wp.vec3d),
    tolerances: wp.array(dtype=wp.float64),
    max_iterations: int,
    work: ArrowWork,
    solutions: wp.array2d(dtype=wp.vec3d),
    iterations: wp.array(dtype=wp.int32),
    residuals: wp.array(dtype=wp.float64),
    breakdowns: wp.array(dtype=wp.int32),
):
    env, lane = wp.tid()
    n = rhs.shape[1]
    zero = wp.float64(0.0)
    infinity = wp.float64(wp.inf)
    r = work.r[env]
    z = work.z[env]
    p = work.p[env]
    dots = work.dots[env]
    share = wp.vec3d()
    for place in range(lane, n, lanes):
        row = order[place]
        solutions[env, row] = wp.vec3d()
        r[place] = rhs[env, row]
        share[0] += wp.dot(rhs[env, row], rhs[env, row])
    if lane == 0:
        iterations[env] = 0
        residuals[env] = zero
        breakdowns[env] = 0
    if active[env] == 0:
        return
    b_sq = team_sum(share, env, 0, 1, lane, 0, work.gates, dots)[0]
    if b_sq == zero:
        return
    goal = tolerances[env] * tolerances[env] * b_sq
    turn = int(1)
    count = int(0)
    broken = int(0)
    if not b_sq < infinity:
        broken = int(1)
    r_sq = b_sq
    rho_old = zero
    while broken == 0 and r_sq > goal and count < max_iterations:
        solve_factored(
            lane,
            lanes,
            lists,
            work.factor[env],
            work.roots[env],
            work.sums[env],
            work.schur[env],
            r,
            work.r_scalars[env],
            z,
            work.z_scalars[env],
        )
        share = wp.vec3d()
        for place in range(lane, n, lanes):
            share[0] += wp.dot(r[place], z[place])
        rho = team_sum(share, env, 0, 1, lane, turn, work.gates, dots)[0]
        turn = 1 - turn
        for place in range(lane, n, lanes):
            p_row = z[place]
            if count > 0:
                p_row += rho / rho_old * p[place]
            p[place] = p_row
        rho_old = rho
        block_barrier()
        p_scalars = work.p_scalars[env]
        parts = work.parts_scalars[env]
        end = 3 * layout.segments.shape[0]
        share = wp.vec3d()
        share[0] = multiply_fixed(lane, end, lanes, layout, packed[env], p_scalars, parts)
        share[0] += multiply_extra(env, lane, lanes, extra, extra_values, p_scalars)
        curvature = team_sum(share, env, 0, 1, lane, turn, work.gates, dots)[0]
        turn = 1 - turn
        if not (rho > zero and curvature > zero and curvature < infinity):
            broken = int(1)
        else:
            alpha = rho / curvature
            share = wp.vec3d()
            for place in range(lane, n, lanes):
                row = order[place]
                solutions[env, row] = solutions[env, row] + alpha * p[place]
                r_row = r[place] - alpha * row_sum(env, place, layout, extra, work.parts[env])
                r[place] = r_row
                share[0] += wp.dot(r_row, r_row)
            r_sq = team_sum(share, env, 0, 1, lane, turn, work.gates, dots)[0]
            turn = 1 - turn
            count += 1
    if lane == 0:
        iterations[env] = count
        breakdowns[env] = broken
        residuals[env] = wp.sqrt(r_sq / b_sq)
        if count == 0:
            residuals[env] = wp.float64(1.0)


class ArrowCG:
    """CG preconditioned by the exact block-arrow factor, one thread block an environment."""

    capturable = True

    def __init__(
        self, problem: LinearProblem, clusters: list[tuple[int, int]], lanes: int | None = None
    ) -> None:
        """``clusters``: ranges of rows of affine bodies, which become the border. ``lanes`` of the
        thread block, chosen by size when left out."""
        self._problem = problem
        device, n = problem.device, problem.pattern.free_count
        none = np.zeros(0, dtype=np.int64)
        border = np.concatenate([none, *(np.arange(first, end) for first, end in clusters)])
        plan = eliminate(problem.pattern, border)
        order = np.concatenate([plan.order, plan.border])
        places = np.empty(n, dtype=np.int64)
        places[order] = np.arange(n)
        self._order = wp.array(order.astype(np.int32), dtype=wp.int32, device=device)
        self._lists = _put_lists(plan, problem, places)
        rows = RowPlan(order, places, none, np.array([0, n]))
        self._values = scalars(problem.values)
        self._packed = PackedRows(problem, rows, lanes)
        self._extra = ExtraRowLists(problem, rows, lanes)
        self._team = Team(team(device, problem.env_count, 3 * n, lanes).lanes)
        self._allocate(plan)
        self.description = (
            f"block-arrow Cholesky, {plan.block_count:,} blocks in {len(plan.level_starts) - 1} "
            f"levels, one kernel, {self._team.lanes} threads an environment"
        )

    def _allocate(self, plan: Elimination) -> None:
        problem = self._problem
        device, envs = problem.device, problem.env_count
        work = self._work = ArrowWork()
        work.r, work.z, work.p = (
            wp.zeros(problem.shape, dtype=wp.vec3d, device=device) for _ in range(3)
        )
        work.r_scalars, work.z_scalars = scalars(work.r), scalars(work.z)
        work.p_scalars = scalars(work.p)

        def numbers(width: int) -> wp.array:
            return wp.zeros((envs, width), dtype=wp.float64, device=device)

        width = 3 * len(plan.border)
        work.factor = problem.scratch.take((envs, 9 * plan.block_count), wp.float64, device)
        work.roots = problem.scratch.take((envs, len(plan.order)), wp.mat33d, device)
        work.schur = numbers(2 * width * width)
        work.sums = numbers(max(SCHUR_CHUNKS * width * width, SUM_CHUNKS * width))
        dots = 2 * self._team.lanes if device.is_cpu else 1
        work.dots = wp.zeros((envs, dots), dtype=wp.vec3d, device=device)
        work.gates = wp.zeros(1, dtype=wp.int32, device=device)
        self._allocate_parts()

    def _allocate_parts(self) -> None:
        problem, work = self._problem, self._work
        shape = (problem.env_count, self._packed.layout.segment_count)
        work.parts = wp.zeros(shape, dtype=wp.vec3d, device=problem.device)
        work.parts_scalars = scalars(work.parts)

    def solve(self, active: wp.array, max_iterations: int) -> None:
        """See ``LinearSystem.solve``."""
        problem, work, lanes = self._problem, self._work, self._team.lanes

        def factor() -> None:
            self._extra.update(active)
            launch_team(
                _factor_kernel,
                problem.env_count,
                self._team,
                [lanes, active, self._lists, self._values, self._extra.rows, problem.extra.places]
                + [self._extra.values],
                [work],
                problem.device,
            )

        side_by_side(problem.device, [factor, lambda: self._packed.update(active, self._values)])
        launch_team(
            _solve_kernel,
            problem.env_count,
            self._team,
            [lanes, active, self._order, self._lists, self._packed.layout, self._packed.values]
            + [self._extra.rows, self._extra.values, problem.rhs, problem.tolerances]
            + [max_iterations, work],
            [problem.solution, problem.iterations, problem.residuals, problem.breakdown],
            problem.device,
        )


def _put_lists(plan: Elimination, problem: LinearProblem, places: np.ndarray) -> ArrowLists:
    """Copy a symbolic factorisation to the device of a problem."""
    lists = ArrowLists()

    def put(array: np.ndarray) -> wp.array:
        dtype = wp.int32 if array.ndim == 1 else wp.vec2i
        return wp.array(array.astype(np.int32), dtype=dtype, device=problem.device)

    for name in ("starts", "columns", "codes", "pair_starts", "pairs", "level_starts"):
        setattr(lists, name, put(getattr(plan, name)))
    for name in ("level_columns", "row_starts", "row_entries", "column_starts", "column_entries"):
        setattr(lists, name, put(getattr(plan, name)))
    numbers = np.full(problem.pattern.free_count, -1)
    numbers[plan.border] = np.arange(len(plan.border))
    lists.border_codes = put(border_codes(problem.pattern, plan.border))
    lists.border_places, lists.places = put(numbers), put(places)
    lists.border_count = len(plan.border)
    return lists
