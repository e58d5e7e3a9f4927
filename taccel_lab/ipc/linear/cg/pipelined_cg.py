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

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.device.block_ops import (
    Team,
    anew,
    block_barrier,
    join_team,
    launch_team,
    team,
    team_barrier,
    team_sum,
)
from taccel_lab.ipc.device.dense_inverse import address_of_tile
from taccel_lab.ipc.linear.cg.control import (
    FIRST,
    RESTART,
    SHOW_X,
    START,
    STEP,
    CgState,
    new_solve,
    next_step,
    report_solve,
    state_load,
)
from taccel_lab.ipc.linear.cg.preconditioner import (
    Clusters,
    DiagonalInverses,
    described,
    preconditioned,
)
from taccel_lab.ipc.linear.cg.streamed_rows import (
    begin_stream,
    end_stream,
    multiply_streamed,
    open_stream,
    room_for_stream,
    stages_of,
)
from taccel_lab.ipc.linear.coarse.matrix import PART_ROWS, CoarseCorrection, coarse_parts
from taccel_lab.ipc.linear.coarse.space import CoarseSpace, add_correction, owned_parts
from taccel_lab.ipc.linear.problem.arrays import LinearProblem
from taccel_lab.ipc.linear.problem.extra_rows import ExtraRowLists, ExtraRows
from taccel_lab.ipc.linear.problem.packed_rows import VERIFY_BELOW, PackedRows, RowSlices
from taccel_lab.ipc.linear.problem.row_plan import plan_rows, scalars
from taccel_lab.ipc.linear.problem.row_products import (
    multiply_extra,
    row_component,
)
from taccel_lab.ipc.linear.problem.turned import reach_m, shortened
from taccel_lab.model.env_lists import EnvMask
from taccel_lab.model.launches import side_by_side

wp.set_module_options({"enable_backward": False})

TASKS_PER_ROW = 6
"""Scalar rows of segments that a row has, about: what a team is sized by."""
PATIENCE = 100_000
"""Clock cycles for which a team waits for blocks that do not run yet: 50 us, a tenth of a solve."""


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
    turn: int,
    state: CgState,
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
    if state.mode == SHOW_X:
        work.m[env, size - turn * size + task] = x[at]
        return wp.vec3d()
    product = zero
    if state.mode == START:
        x[at] = zero
    else:
        product = row_component(env, task, layout, has_extra, extra, work.parts[env])
    if state.mode < FIRST:
        rest = b[at] - product
        work.r[env, task] = rest
        work.w[env, task] = rest
        return wp.vec3d(zero, zero, rest * rest)
    m = work.m[env, turn * size + task]
    r = work.r[env, task]
    u = m
    w = product
    if state.mode == STEP:
        u = work.u[env, task]
        w = work.w[env, task]
        p = work.p[env, task]
        s = work.s[env, task]
        q = work.q[env, task]
        z = work.z[env, task]
        done = x[at]
        if state.beta == zero:
            p = u
            s = w
            q = m
            z = product
        else:
            p = u + state.beta * p
            s = w + state.beta * s
            q = m + state.beta * q
            z = product + state.beta * z
        work.p[env, task] = p
        work.s[env, task] = s
        work.q[env, task] = q
        work.z[env, task] = z
        x[at] = done + state.way * p
        r = r - state.alpha * s
        u = u - state.alpha * q
        w = w - state.alpha * z
        work.r[env, task] = r
    work.u[env, task] = u
    work.w[env, task] = w
    return wp.vec3d(r * u, w * u, r * r)


@cache
def _solve_kernel(room: int) -> Any:
    """The kernel, with ``room`` numbers of shared memory."""
    address = address_of_tile(room)

    @wp.kernel(grid_stride=False, launch_bounds=(512, 1), module="unique", enable_backward=False)
    def pipelined_kernel(
        lanes: int,
        stages: int,
        most_blocks: int,
        patience: int,
        active: wp.array(dtype=wp.int32),
        order: wp.array(dtype=wp.int32),
        block_starts: wp.array(dtype=wp.int32),
        layout: RowSlices,
        all_values: wp.array2d(dtype=wp.float64),
        all_packed: wp.array2d(dtype=wp.float32),
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
        reach: wp.float64,
        work: PipelineWork,
        solutions: wp.array2d(dtype=wp.float64),
        iterations: wp.array(dtype=wp.int32),
        residuals: wp.array(dtype=wp.float64),
        breakdowns: wp.array(dtype=wp.int32),
    ):
        index, lane = wp.tid()
        memory = address(wp.tile_empty(shape=room, dtype=wp.float64, storage="shared"))
        env = index / most_blocks
        size = rhs.shape[1]
        zero = wp.float64(0.0)
        x = solutions[env]
        if active[env] == 0:
            at = index % most_blocks * lanes + lane
            for i in range(at, size, most_blocks * lanes):
                x[i] = zero
            if at == 0:
                report_solve(env, CgState(), iterations, residuals, breakdowns)
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
        first_slice = layout.task_starts[first_part] / 32
        end_slice = layout.task_starts[end_part] / 32
        stream = open_stream(lane, lanes, first_slice, end_slice, layout, memory, stages)
        owned = owned_parts(coarse, first_part, end_part)
        has_extra = extra.totals[env, 1] > 0
        turn = int(0)
        state = new_solve()
        while state.running == 1:
            share = wp.vec3d()
            here = anew(env)
            for task in range(first + lane, end, lanes):
                at = 3 * order[task / 3] + task % 3
                share += _update(
                    here,
                    task,
                    at,
                    turn,
                    state,
                    layout,
                    has_extra,
                    extra,
                    rhs[here],
                    work,
                    solutions[here],
                )
            turn = 1 - turn
            if state.mode != SHOW_X:
                block_barrier()
                here = anew(env)
                for task in range(first + lane, end, lanes):
                    work.m[here, turn * size + task] = preconditioned(
                        task, clusters, all_stores[here], inverses[here], work.w[here]
                    )
                if coarse.width > 0:
                    here = anew(env)
                    add_correction(
                        here,
                        owned,
                        blocks,
                        lane,
                        lanes,
                        coarse,
                        work.gates,
                        work.w_rows[here],
                        work.m_rows[here, turn * size / 3 : (turn + 1) * size / 3],
                    )
            here = anew(env)
            begin_stream(stream, layout, all_packed[here])
            sums = team_sum(share, here, block, blocks, lane, turn, work.gates, work.sums[here])
            if state.mode == START:
                state = state_load(state, sums[2], tolerances[here])
                if not (sums[2] > zero and sums[2] < wp.float64(wp.inf)):
                    state.running = 0
                    if sums[2] != zero:
                        state.broken = 1
                state.mode = FIRST
            elif state.mode == SHOW_X:
                state.mode = RESTART
            elif state.mode == RESTART:
                state.mode = FIRST
            else:
                verifies = tolerances[here] < verify_below
                state = next_step(state, sums, verifies, max_iterations)
            if state.running == 1 and state.mode != SHOW_X:
                here = anew(env)
                m = work.m[here, turn * size : (turn + 1) * size]
                # Stiff bodies make up for little of what rounding takes from them.
                exact_rows = clusters.tasks.shape[0] / 3
                if state.mode == RESTART:
                    exact_rows = size / 3
                multiply_streamed(
                    lane,
                    stream,
                    exact_rows,
                    layout,
                    all_values[here],
                    all_packed[here],
                    m,
                    work.parts[here],
                )
                if has_extra:
                    multiply_extra(
                        here,
                        block * lanes + lane,
                        blocks * lanes,
                        extra,
                        extra_values,
                        m,
                    )
                    team_barrier(here, blocks, work.gates)
                else:
                    block_barrier()
        end_stream()
        if state.broken == 1:
            share = wp.vec3d()
            for task in range(first + lane, end, lanes):
                at = 3 * order[task / 3] + task % 3
                share += wp.vec3d(x[at] * x[at], x[at] * rhs[env, at], zero)
            sums = team_sum(share, env, block, blocks, lane, 1 - turn, work.gates, work.sums[env])
            part = shortened(sums[0], sums[1], reach)
            for task in range(first + lane, end, lanes):
                at = 3 * order[task / 3] + task % 3
                x[at] = part * x[at]
            if part == zero:
                state.count = 0
        if block == 0 and lane == 0:
            report_solve(env, state, iterations, residuals, breakdowns)

    return pipelined_kernel


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
        self._stages = stages_of(device)
        self._kernel = _solve_kernel(room_for_stream(size.lanes, self._stages))
        plan = plan_rows(n, groups, size.blocks, parts)

        def put(array: np.ndarray) -> wp.array:
            return wp.array(array.astype(np.int32), dtype=wp.int32, device=device)

        self._order, self._block_starts = put(plan.order), put(plan.block_starts)
        self._values = scalars(problem.values)
        self._rhs, self._solution = scalars(problem.rhs), scalars(problem.solution)
        self._packed = PackedRows(problem, plan, lanes)
        self._reach = reach_m(problem, clusters)
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

    def solve(self, active: EnvMask, max_iterations: int) -> None:
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
        inputs = [self._team.lanes, self._stages, self._team.blocks, self._patience, active]
        inputs += [self._order, self._block_starts, layout, self._values, self._packed.values]
        inputs += [self._extra.rows, self._extra.values, scalars(self._inverses.blocks)]
        inputs += [self._inverses.clusters, self._inverses.stores, self._coarse.space]
        inputs += [scalars(problem.rhs), problem.tolerances, wp.float64(VERIFY_BELOW)]
        inputs += [
            max_iterations,
            wp.float64(self._reach),
            work,
            self._solution,
            problem.iterations,
            problem.residuals,
        ]
        launch_team(self._kernel, problem.env_count, self._team, *inputs, problem.breakdown)
