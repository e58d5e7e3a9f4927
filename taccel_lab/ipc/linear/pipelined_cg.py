# SPDX-License-Identifier: Apache-2.0
"""Conjugate gradients with several thread blocks an environment: a whole solve in one kernel.

For GPUs, large systems and few environments. Blocks on different multiprocessors have to wait for
each other through memory, which takes longer than their share of a product. The recurrence of
[Ghysels and Vanroose 2014, Hiding global synchronization latency in the preconditioned conjugate
gradient algorithm] waits once an iteration: with u = M^-1 r, w = A u, m = M^-1 w and n = A m it
updates p, s = A p, q = M^-1 s and z = A q alike, and the dot products (r, u) and (w, u) are those
of the last iteration. Blocks own rows with all of their segments and clusters, so that nothing but
m, and the sums, passes between them; extra blocks make them wait once more.

On Newton matrices of gels in contact it takes as many iterations as the plain recurrence, to 1e-10.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.branches import side_by_side
from taccel_lab.ipc.linear.block_ops import (
    Team,
    block_barrier,
    join_team,
    launch_team,
    team,
    team_barrier,
    team_sum,
)
from taccel_lab.ipc.linear.coarse_matrix import PART_ROWS, CoarseCorrection, coarse_parts
from taccel_lab.ipc.linear.coarse_space import CoarseSpace, add_correction, owned_parts
from taccel_lab.ipc.linear.extra_rows import ExtraRowLists, ExtraRows
from taccel_lab.ipc.linear.packed_rows import PackedRows, RowSlices
from taccel_lab.ipc.linear.preconditioner import (
    Clusters,
    DiagonalInverses,
    described,
    preconditioned,
)
from taccel_lab.ipc.linear.problem import LinearProblem
from taccel_lab.ipc.linear.row_lists import scalars
from taccel_lab.ipc.linear.row_plan import plan_rows
from taccel_lab.ipc.linear.row_products import (
    multiply_extra,
    multiply_fixed,
    row_component,
)

wp.set_module_options({"enable_backward": False})

VERIFY_BELOW = 1e-3
"""Tolerance below which the true residual is checked, and CG started anew where it falls short: on
stiff random matrices the one that the recurrence updates is off by up to 5e-7 of the load."""
TASKS_PER_ROW = 6
"""Scalar rows of segments that a row has, about: what a team is sized by."""
PATIENCE = 100_000
"""Clock cycles for which a team waits for blocks that do not run yet: 50 us, a tenth of a solve."""

# What a pass over the rows does; but for the first two it follows a product.
_START = wp.constant(0)  # r = b; m = M^-1 r
_SHOW_X = wp.constant(1)  # m = x, to multiply that
_RESTART = wp.constant(2)  # r = b - A x; m = M^-1 r
_FIRST = wp.constant(3)  # u = m, w = A u; m = M^-1 w
_STEP = wp.constant(4)  # a step of CG; m = M^-1 w


@wp.struct
class PipelineWork:
    """Vectors by scalar places, [env_count, 3 row_count], some also by places.

    w: what is preconditioned next. m: two copies, as blocks still read the last one while others
    write the next, [env_count, 6 row_count].
    parts: products of segments, [env_count, 3 segment_count].
    sums, gates: see ``team_sum``.
    """

    r: wp.array2d(dtype=wp.float64)
    u: wp.array2d(dtype=wp.float64)
    w: wp.array2d(dtype=wp.float64)
    m: wp.array2d(dtype=wp.float64)
    p: wp.array2d(dtype=wp.float64)
    s: wp.array2d(dtype=wp.float64)
    q: wp.array2d(dtype=wp.float64)
    z: wp.array2d(dtype=wp.float64)
    w_rows: wp.array2d(dtype=wp.vec3d)
    m_rows: wp.array2d(dtype=wp.vec3d)
    parts: wp.array2d(dtype=wp.float64)
    sums: wp.array2d(dtype=wp.vec3d)
    gates: wp.array(dtype=wp.int32)


@wp.func
def _update(
    env: int,
    task: int,
    at: int,
    mode: int,
    turn: int,
    alpha: wp.float64,
    beta: wp.float64,
    layout: RowSlices,
    has_extra: bool,
    extra: ExtraRows,
    b: wp.array(dtype=wp.float64),
    work: PipelineWork,
    x: wp.array(dtype=wp.float64),
) -> wp.vec3d:
    """A pass over one scalar, but for what is preconditioned; ``at``: of b and x. Returns its share
    of (r.u, w.u, r.r).

    All that is read comes before what is written, or each would wait for the last.
    """
    zero = wp.float64(0.0)
    size = b.shape[0]
    if mode == _SHOW_X:
        work.m[env, size - turn * size + task] = x[at]
        return wp.vec3d()
    product = zero
    if mode == _START:
        x[at] = zero
    else:
        product = row_component(env, task, layout, has_extra, extra, work.parts[env])
    if mode < _FIRST:
        rest = b[at] - product
        work.r[env, task] = rest
        work.w[env, task] = rest
        return wp.vec3d(zero, zero, rest * rest)
    m = work.m[env, turn * size + task]
    r = work.r[env, task]
    u = m
    w = product
    if mode == _STEP:
        u = work.u[env, task]
        w = work.w[env, task]
        p = work.p[env, task]
        s = work.s[env, task]
        q = work.q[env, task]
        z = work.z[env, task]
        done = x[at]
        if beta == zero:
            p = u
            s = w
            q = m
            z = product
        else:
            p = u + beta * p
            s = w + beta * s
            q = m + beta * q
            z = product + beta * z
        work.p[env, task] = p
        work.s[env, task] = s
        work.q[env, task] = q
        work.z[env, task] = z
        x[at] = done + alpha * p
        r = r - alpha * s
        u = u - alpha * q
        w = w - alpha * z
        work.r[env, task] = r
    work.u[env, task] = u
    work.w[env, task] = w
    return wp.vec3d(r * u, w * u, r * r)


@wp.kernel(grid_stride=False, launch_bounds=(512, 1))
def _solve_kernel(
    lanes: int,
    most_blocks: int,
    patience: int,
    active: wp.array(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
    block_starts: wp.array(dtype=wp.int32),
    layout: RowSlices,
    all_packed: wp.array2d(dtype=wp.float64),
    extra: ExtraRows,
    extra_values: wp.array(dtype=wp.float64),
    inverses: wp.array2d(dtype=wp.float64),
    clusters: Clusters,
    all_stores: wp.array2d(dtype=wp.float64),
    coarse: CoarseSpace,
    rhs: wp.array2d(dtype=wp.float64),
    tolerances: wp.array(dtype=wp.float64),
    verify_below: wp.float64,
    max_iterations: int,
    work: PipelineWork,
    solutions: wp.array2d(dtype=wp.float64),
    iterations: wp.array(dtype=wp.int32),
    residuals: wp.array(dtype=wp.float64),
    breakdowns: wp.array(dtype=wp.int32),
):
    index, lane = wp.tid()
    env = index / most_blocks
    size = rhs.shape[1]
    zero = wp.float64(0.0)
    infinity = wp.float64(wp.inf)
    x = solutions[env]
    if active[env] == 0:
        at = index % most_blocks * lanes + lane
        for i in range(at, size, most_blocks * lanes):
            x[i] = zero
        if at == 0:
            iterations[env] = 0
            residuals[env] = zero
            breakdowns[env] = 0
        return
    joined = join_team(env, most_blocks, patience, work.gates)
    block = joined[0]
    blocks = joined[1]
    if blocks == 0:
        return
    # Parts of the rows are made for all blocks; who is there takes those of the others, too.
    first_part = block * most_blocks / blocks
    end_part = (block + 1) * most_blocks / blocks
    first = 3 * block_starts[first_part]
    end = 3 * block_starts[end_part]
    b = rhs[env]
    parts = work.parts[env]
    first_task = layout.task_starts[first_part]
    end_task = layout.task_starts[end_part]
    owned = owned_parts(coarse, first_part, end_part)
    has_extra = extra.totals[env, 1] > 0
    verifies = tolerances[env] < verify_below
    count = int(0)
    broken = int(0)
    turn = int(0)
    mode = int(_START)
    b_sq = zero
    r_sq = zero
    goal = zero
    start_sq = infinity
    alpha = wp.float64(1.0)
    beta = zero
    rho = wp.float64(1.0)
    running = int(1)
    while running == 1:
        share = wp.vec3d()
        for task in range(first + lane, end, lanes):
            at = 3 * order[task / 3] + task % 3
            share += _update(
                env, task, at, mode, turn, alpha, beta, layout, has_extra, extra, b, work, x
            )
        turn = 1 - turn
        if mode != _SHOW_X:
            block_barrier()
            for task in range(first + lane, end, lanes):
                work.m[env, turn * size + task] = preconditioned(
                    task, clusters, all_stores[env], inverses[env], work.w[env]
                )
        if mode != _SHOW_X and coarse.width > 0:
            add_correction(
                env,
                owned,
                blocks,
                lane,
                lanes,
                coarse,
                work.gates,
                work.w_rows[env],
                work.m_rows[env, turn * size / 3 : (turn + 1) * size / 3],
            )
        total = team_sum(share, env, block, blocks, lane, turn, work.gates, work.sums[env])
        if mode == _START:
            b_sq = total[2]
            r_sq = b_sq
            goal = tolerances[env] * tolerances[env] * b_sq
            if not (b_sq > zero and b_sq < infinity):
                running = int(0)
                if b_sq != zero:
                    broken = int(1)
            mode = int(_FIRST)
        elif mode == _SHOW_X:
            mode = int(_RESTART)
        elif mode == _RESTART:
            mode = int(_FIRST)
        else:
            fresh = mode == _FIRST
            r_sq = total[2]
            beta = total[0] / rho
            if fresh:
                beta = zero
            curvature = total[1] - beta * total[0] / alpha
            alpha = total[0] / curvature
            rho = total[0]
            mode = int(_STEP)
            # A true residual may miss by a thousandth: not worth a fresh start.
            limit = goal
            if fresh:
                limit = wp.float64(1.001) * goal
            sound = rho > zero and curvature > zero and curvature < infinity and r_sq < infinity
            if r_sq <= limit and r_sq < infinity:
                running = int(0)
                if verifies and not fresh and count < max_iterations:
                    # What the rounding of the recurrence left is solved for in a fresh start.
                    mode = int(_SHOW_X)
                    running = int(1)
            elif fresh and r_sq > wp.float64(0.25) * start_sq:
                # Starting anew did not help the last time.
                broken = int(1)
                running = int(0)
            elif not sound and not fresh and r_sq < wp.float64(1e-6) * b_sq:
                # As close as this, it may well be rounding that spoils the curvature.
                mode = int(_SHOW_X)
            elif not sound:
                broken = int(1)
                running = int(0)
            elif count >= max_iterations:
                running = int(0)
            else:
                count += 1
            if fresh:
                start_sq = r_sq
        if running == 1 and mode != _SHOW_X:
            m = work.m[env, turn * size : (turn + 1) * size]
            multiply_fixed(first_task + lane, end_task, lanes, layout, all_packed[env], m, parts)
            if has_extra:
                multiply_extra(
                    env,
                    block * lanes + lane,
                    blocks * lanes,
                    extra,
                    extra_values,
                    m,
                )
                team_barrier(env, blocks, work.gates)
            else:
                block_barrier()
    if block == 0 and lane == 0:
        iterations[env] = count
        breakdowns[env] = broken
        if b_sq == zero:
            residuals[env] = zero
        elif count == 0:
            residuals[env] = wp.float64(1.0)
        else:
            residuals[env] = wp.sqrt(r_sq / b_sq)


class PipelinedCG:
    """Pipelined CG preconditioned as ``BlockCG`` is, a team of thread blocks an environment."""

    def __init__(
        self,
        problem: LinearProblem,
        clusters: list[tuple[int, int]],
        lanes: int | None = None,
        blocks: int | None = None,
        patience: int = PATIENCE,
        part_rows: int = PART_ROWS,
    ) -> None:
        """``clusters``: ranges of rows that are stiff among themselves; ``part_rows``: see
        ``coarse_parts``. ``lanes`` of a thread block and ``blocks`` of a team are chosen by size
        when left out. ``patience``: see ``join_team``."""
        self._problem = problem
        self._patience = patience
        device, n = problem.device, problem.pattern.free_count
        groups = [np.arange(first, end) for first, end in clusters]
        parts = coarse_parts(problem, groups, part_rows)
        size = team(device, problem.env_count, TASKS_PER_ROW * n, lanes, blocks)
        if device.is_cpu:
            size = Team(size.lanes)
        self._team = size
        plan = plan_rows(n, groups, size.blocks, parts)

        def put(array: np.ndarray) -> wp.array:
            return wp.array(array.astype(np.int32), dtype=wp.int32, device=device)

        self._order, self._block_starts = put(plan.order), put(plan.block_starts)
        self._values = scalars(problem.values)
        self._rhs, self._solution = scalars(problem.rhs), scalars(problem.solution)
        self._packed = PackedRows(problem, plan, lanes)
        self._inverses = DiagonalInverses(problem, plan, lanes)
        self._coarse = CoarseCorrection(problem, plan, parts, lanes)
        self._extra = ExtraRowLists(problem, plan, lanes)
        work = self._work = PipelineWork()
        for name in "rupsqz":
            shape = (problem.env_count, 3 * n)
            setattr(work, name, wp.zeros(shape, dtype=wp.float64, device=device))
        work.w_rows = wp.zeros(problem.shape, dtype=wp.vec3d, device=device)
        work.m_rows = wp.zeros((problem.env_count, 2 * n), dtype=wp.vec3d, device=device)
        work.w, work.m = scalars(work.w_rows), scalars(work.m_rows)
        slots = 2 * (size.lanes if device.is_cpu else size.blocks)
        work.sums = wp.zeros((problem.env_count, slots), dtype=wp.vec3d, device=device)
        work.gates = wp.zeros(32 * problem.env_count, dtype=wp.int32, device=device)
        shape = (problem.env_count, 3 * self._packed.layout.segment_count)
        work.parts = wp.zeros(shape, dtype=wp.float64, device=device)
        self.description = (
            f"pipelined CG preconditioned by {described(groups)}{self._coarse}, one kernel, "
            f"{size.blocks} x {size.lanes} threads an environment"
        )

    def solve(self, active: wp.array, max_iterations: int) -> None:
        """See ``LinearSystem.solve``."""
        problem, work = self._problem, self._work
        side_by_side(
            problem.device,
            [
                lambda: self._packed.update(active, self._values),
                lambda: self._inverses.update(active, self._values),
                lambda: self._coarse.update(active),
                lambda: self._extra.update(active),
            ],
        )
        layout = self._packed.layout
        work.gates.zero_()
        launch_team(
            _solve_kernel,
            problem.env_count,
            self._team,
            [self._team.lanes, self._team.blocks, self._patience, active, self._order]
            + [self._block_starts, layout, self._packed.values]
            + [self._extra.rows, self._extra.values]
            + [scalars(self._inverses.blocks), self._inverses.clusters, self._inverses.stores]
            + [self._coarse.space]
            + [
                scalars(problem.rhs),
                problem.tolerances,
                wp.float64(VERIFY_BELOW),
                max_iterations,
                work,
            ],
            [self._solution, problem.iterations, problem.residuals, problem.breakdown],
            problem.device,
        )
