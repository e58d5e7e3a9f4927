# SPDX-License-Identifier: Apache-2.0
"""Direct solution of small gels in block-arrow form, in the shared memory of one thread block.

The method of ``arrow_cg`` for systems whose factor fits: one kernel copies the matrix, factors it
and solves. The factor is that of the whole matrix unless gels touch each other. Without such extra
blocks its solution is taken as it is: one iteration, and a residual that is reported as zero
because nobody multiplies it out. With them CG makes up for what the factor leaves out, and only
then the matrix is laid out for products.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.linear.block_ops import Team, block_barrier, launch_team, team, team_sum
from taccel_lab.ipc.linear.elimination import Elimination, border_codes, eliminate
from taccel_lab.ipc.linear.extra_rows import ExtraRowLists, ExtraRows
from taccel_lab.ipc.linear.packed_rows import RowSlices, pack_slices, row_slices
from taccel_lab.ipc.linear.problem import LinearProblem
from taccel_lab.ipc.linear.row_lists import scalars
from taccel_lab.ipc.linear.row_plan import RowPlan
from taccel_lab.ipc.linear.row_products import multiply_extra, multiply_fixed, row_sum
from taccel_lab.ipc.linear.shared_factor import factor_shared, finish_shared, load_shared
from taccel_lab.ipc.linear.shared_lists import (
    SHARED_NUMBERS,
    SharedLayout,
    SharedProgram,
    shared_program,
)
from taccel_lab.ipc.linear.shared_solve import get_shared, put_shared, solve_shared
from taccel_lab.model.matrix_pattern import BlockPattern

wp.set_module_options({"enable_backward": False})

_STATIC_BYTES = 6144
"""What Warp and ``team_sum`` take of the shared memory of a block beside our numbers."""
_LANES = 512
_HASTES = (1.0, 0.25, 0.0)
"""See ``least_degree_order``; two gels of 83 nodes take 20, 22 and 22 levels."""


@wp.struct
class SharedLists:
    """What all environments share.

    order: row at each place. codes: block of the pattern of each block of the factor, -1 for none.
    program: see ``SharedLayout``. border_codes, border_places, places: see ``ArrowLists``.
    """

    order: wp.array(dtype=wp.int32)
    codes: wp.array(dtype=wp.int32)
    program: wp.array(dtype=wp.int32)
    border_codes: wp.array(dtype=wp.int32)
    border_places: wp.array(dtype=wp.int32)
    places: wp.array(dtype=wp.int32)


@wp.struct
class SharedWork:
    """What CG needs beside shared memory: p by places, [env_count, row_count], packed rows, and
    products of segments. dots, gates: see ``team_sum``."""

    p: wp.array2d(dtype=wp.vec3d)
    p_scalars: wp.array2d(dtype=wp.float64)
    packed: wp.array2d(dtype=wp.float64)
    parts: wp.array2d(dtype=wp.vec3d)
    parts_scalars: wp.array2d(dtype=wp.float64)
    dots: wp.array2d(dtype=wp.vec3d)
    gates: wp.array(dtype=wp.int32)


@wp.func_native("return reinterpret_cast<wp::uint64>(tile.data.ptr);")
def _address(tile: wp.tile(dtype=wp.float64, shape=(SHARED_NUMBERS,))) -> wp.uint64:
    """Address of a tile in shared memory."""
    ...


@wp.func
def _put(shared: wp.uint64, first: int, place: int, value: wp.vec3d):
    put_shared(shared, first + 3 * place, value[0])
    put_shared(shared, first + 3 * place + 1, value[1])
    put_shared(shared, first + 3 * place + 2, value[2])


@wp.func
def _get(shared: wp.uint64, first: int, place: int) -> wp.vec3d:
    at = first + 3 * place
    return wp.vec3d(get_shared(shared, at), get_shared(shared, at + 1), get_shared(shared, at + 2))


@wp.kernel(grid_stride=False, launch_bounds=(512, 1))
def _solve_kernel(
    lanes: int,
    active: wp.array(dtype=wp.int32),
    lists: SharedLists,
    layout: SharedLayout,
    slices: RowSlices,
    values: wp.array2d(dtype=wp.float64),
    extra_counts: wp.array(dtype=wp.int32),
    extra: ExtraRows,
    extra_places: wp.array(dtype=wp.vec2i),
    extra_values: wp.array(dtype=wp.float64),
    rhs: wp.array2d(dtype=wp.vec3d),
    tolerances: wp.array(dtype=wp.float64),
    max_iterations: int,
    work: SharedWork,
    solutions: wp.array2d(dtype=wp.vec3d),
    iterations: wp.array(dtype=wp.int32),
    residuals: wp.array(dtype=wp.float64),
    breakdowns: wp.array(dtype=wp.int32),
):
    env, lane = wp.tid()
    tile = wp.tile_empty(shape=SHARED_NUMBERS, dtype=wp.float64, storage="shared")
    shared = _address(tile)
    n = rhs.shape[1]
    dots = work.dots[env]
    zero = wp.float64(0.0)
    infinity = wp.float64(wp.inf)
    share = wp.vec3d()
    for place in range(lane, n, lanes):
        row = lists.order[place]
        load = rhs[env, row]
        solutions[env, row] = wp.vec3d()
        share[0] += wp.dot(load, load)
        _put(shared, layout.r, place, load)
        _put(shared, layout.z, place, load)
    if lane == 0:
        iterations[env] = 0
        residuals[env] = zero
        breakdowns[env] = 0
    if active[env] == 0:
        return
    b_sq = team_sum(share, env, 0, 1, lane, 0, work.gates, dots)[0]
    if b_sq == zero:
        return
    first = extra.starts[env][0]
    end = extra.starts[env + 1][0]
    extra_count = int(0)
    if extra_counts[env] > 0:
        extra_count = extra.totals[env, 0]
    load_shared(
        shared,
        lane,
        lanes,
        layout,
        lists.program,
        lists.codes,
        values[env],
        lists.places,
        lists.border_places,
        extra_count,
        extra.codes[2 * first : 2 * end],
        extra_places[first:end],
        extra_values[9 * first : 9 * end],
    )
    factor_shared(shared, lane, lanes, layout)
    finish_shared(
        shared,
        lane,
        lanes,
        layout,
        values[env],
        lists.border_codes,
        lists.border_places,
        extra_count,
        extra.codes[2 * first : 2 * end],
        extra_places[first:end],
        extra_values[9 * first : 9 * end],
    )
    exact = get_shared(shared, layout.flag) == zero
    p = work.p[env]
    p_scalars = work.p_scalars[env]
    parts = work.parts_scalars[env]
    packed = work.packed[env]
    goal = tolerances[env] * tolerances[env] * b_sq
    r_sq = b_sq
    rho_old = zero
    count = int(0)
    broken = int(0)
    # One loop for both cases: a second copy of the solve would double the code to fetch.
    going = int(1)
    while going == 1:
        going = int(0)
        solve_shared(shared, lane, lanes, layout)
        share = wp.vec3d()
        for place in range(lane, n, lanes):
            share[0] += wp.dot(_get(shared, layout.r, place), _get(shared, layout.x, place))
        # The other turn than the sum before, or barriers between them.
        rho = team_sum(share, env, 0, 1, lane, 1, work.gates, dots)[0]
        if not (rho > zero and rho < infinity and b_sq < infinity):
            broken = int(1)
        elif exact:
            for place in range(lane, n, lanes):
                solutions[env, lists.order[place]] = _get(shared, layout.x, place)
            count = int(1)
            r_sq = zero
        else:
            if count == 0:
                pack_slices(lane, lanes, slices, values[env], packed)
            for place in range(lane, n, lanes):
                p_row = _get(shared, layout.x, place)
                if count > 0:
                    p_row += rho / rho_old * p[place]
                p[place] = p_row
            rho_old = rho
            block_barrier()
            end = 3 * slices.segments.shape[0]
            share = wp.vec3d()
            share[0] = multiply_fixed(lane, end, lanes, slices, packed, p_scalars, parts)
            share[0] += multiply_extra(env, lane, lanes, extra, extra_values, p_scalars)
            curvature = team_sum(share, env, 0, 1, lane, 0, work.gates, dots)[0]
            if not (curvature > zero and curvature < infinity):
                broken = int(1)
            else:
                alpha = rho / curvature
                share = wp.vec3d()
                for place in range(lane, n, lanes):
                    row = lists.order[place]
                    solutions[env, row] = solutions[env, row] + alpha * p[place]
                    r_row = _get(shared, layout.r, place)
                    r_row -= alpha * row_sum(env, place, slices, extra, work.parts[env])
                    _put(shared, layout.r, place, r_row)
                    _put(shared, layout.z, place, r_row)
                    share[0] += wp.dot(r_row, r_row)
                r_sq = team_sum(share, env, 0, 1, lane, 1, work.gates, dots)[0]
                count += 1
                if r_sq > goal and count < max_iterations:
                    going = int(1)
    if lane == 0:
        iterations[env] = count
        breakdowns[env] = broken
        residuals[env] = wp.sqrt(r_sq / b_sq)
        if count == 0:
            residuals[env] = wp.float64(1.0)


def plan_shared(
    pattern: BlockPattern, clusters: list[tuple[int, int]]
) -> tuple[Elimination, SharedProgram]:
    """Factorisation with the rows of affine bodies as the border, in as few levels as there is
    room for; the last attempt where there is none."""
    none = np.zeros(0, dtype=np.int64)
    border = np.concatenate([none, *(np.arange(first, end) for first, end in clusters)])
    for haste in _HASTES:
        plan = eliminate(pattern, border, haste)
        program = shared_program(plan)
        if program.fits:
            break
    return plan, program


def fits_shared(pattern: BlockPattern, clusters: list[tuple[int, int]], device: wp.Device) -> bool:
    """Whether a thread block of the device can hold the factor of a pattern."""
    room = 8 * SHARED_NUMBERS + _STATIC_BYTES
    if device.is_cuda and device.max_shared_memory_per_block < room:
        return False
    return plan_shared(pattern, clusters)[1].fits


class ArrowShared:
    """Block-arrow factor in shared memory, one thread block an environment."""

    capturable = True

    def __init__(
        self, problem: LinearProblem, clusters: list[tuple[int, int]], lanes: int | None = None
    ) -> None:
        """``clusters``: ranges of rows of affine bodies, which become the border. ``lanes`` of the
        thread block, chosen by size when left out. Needs ``fits_shared``."""
        self._problem = problem
        device, n = problem.device, problem.pattern.free_count
        plan, program = plan_shared(problem.pattern, clusters)
        if not program.fits:
            raise InputError(
                f"linear_method arrow-shared: the factor takes {program.numbers:,} numbers of "
                f"shared memory, a block has {SHARED_NUMBERS:,}; use another, such as ssor"
            )
        order = np.concatenate([plan.order, plan.border])
        places = np.empty(n, dtype=np.int64)
        places[order] = np.arange(n)
        numbers = np.full(n, -1)
        numbers[plan.border] = np.arange(len(plan.border))
        self._layout = program.layout
        self._lists = lists = SharedLists()
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
        self._extra = ExtraRowLists(problem, rows, lanes)
        self._team = Team(team(device, problem.env_count, 3 * n, lanes or _LANES).lanes)
        self._allocate()
        self.description = (
            f"block-arrow Cholesky in shared memory, {plan.block_count:,} blocks in "
            f"{program.layout.level_count} levels, {self._team.lanes} threads an environment"
        )

    def _allocate(self) -> None:
        problem = self._problem
        device, envs = problem.device, problem.env_count
        work = self._work = SharedWork()
        work.p = wp.zeros(problem.shape, dtype=wp.vec3d, device=device)
        work.p_scalars = scalars(work.p)
        shape = (envs, 3 * len(self._slices.columns))
        work.packed = problem.scratch.take(shape, wp.float64, device)
        dots = 2 * self._team.lanes if device.is_cpu else 1
        work.dots = wp.zeros((envs, dots), dtype=wp.vec3d, device=device)
        work.gates = wp.zeros(1, dtype=wp.int32, device=device)
        self._allocate_parts()

    def _allocate_parts(self) -> None:
        problem, work = self._problem, self._work
        shape = (problem.env_count, self._slices.segment_count)
        work.parts = wp.zeros(shape, dtype=wp.vec3d, device=problem.device)
        work.parts_scalars = scalars(work.parts)

    def solve(self, active: wp.array, max_iterations: int) -> None:
        """See ``LinearSystem.solve``; residuals of exact solutions read 0."""
        problem = self._problem
        self._extra.update(active)
        launch_team(
            _solve_kernel,
            problem.env_count,
            self._team,
            [self._team.lanes, active, self._lists, self._layout, self._slices, self._values]
            + [problem.extra.counts, self._extra.rows, problem.extra.places, self._extra.values]
            + [problem.rhs, problem.tolerances, max_iterations, self._work],
            [problem.solution, problem.iterations, problem.residuals, problem.breakdown],
            problem.device,
        )
