# SPDX-License-Identifier: Apache-2.0
"""Conjugate gradients with one thread block an environment: a whole solve in one kernel.

For GPUs and many small systems. An environment that has converged, or that is at rest, costs
nothing, and nobody waits for the host or for other environments. The recurrence is that of
[Chronopoulos and Gear 1989, s-step iterative methods for symmetric linear systems], which needs the
three dot products of an iteration at one time: with z = M^-1 r and w = A z, the direction is
p = z + beta p, its product A p = w + beta A p, and its curvature (z, w) - beta (r, z) / alpha_old.
An iteration waits at two barriers, three with clusters.

Vectors are kept by the places of a ``RowPlan``, the matrix in slices (``packed_rows``).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.device.block_ops import Team, anew, block_barrier, launch_team, team, team_sum
from taccel_lab.ipc.device.dense_inverse import address_of_tile
from taccel_lab.ipc.linear.cg.control import (
    RESTART,
    SHOW_X,
    START,
    CgState,
    new_solve,
    next_step,
    report_solve,
    state_load,
)
from taccel_lab.ipc.linear.cg.preconditioner import (
    Clusters,
    DiagonalInverses,
    cluster_product,
    described,
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
from taccel_lab.ipc.linear.problem.row_products import multiply_extra, row_sum
from taccel_lab.ipc.linear.problem.turned import reach_m, shortened
from taccel_lab.model.env_lists import EnvMask
from taccel_lab.model.launches import side_by_side

wp.set_module_options({"enable_backward": False})


@wp.struct
class CgWork:
    """Vectors of CG by places, [env_count, row_count], some also as scalars.

    parts: products of segments, [env_count, segment_count].
    sums, gates: see ``team_sum``.
    """

    r: wp.array2d(dtype=wp.vec3d)
    z: wp.array2d(dtype=wp.vec3d)
    p: wp.array2d(dtype=wp.vec3d)
    q: wp.array2d(dtype=wp.vec3d)
    parts: wp.array2d(dtype=wp.vec3d)
    sums: wp.array2d(dtype=wp.vec3d)
    gates: wp.array(dtype=wp.int32)
    r_scalars: wp.array2d(dtype=wp.float64)
    z_scalars: wp.array2d(dtype=wp.float64)
    parts_scalars: wp.array2d(dtype=wp.float64)


@wp.func
def _update_row(
    env: int,
    place: int,
    row: int,
    state: CgState,
    layout: RowSlices,
    has_extra: bool,
    extra: ExtraRows,
    b: wp.array(dtype=wp.vec3d),
    inverse: wp.mat33d,
    work: CgWork,
    x: wp.array(dtype=wp.vec3d),
) -> wp.vec3d:
    """New r, z, p, q and x at a place; returns its share of (r.z, 0, r.r).

    All that is read comes before what is written, or each would wait for the last.
    """
    if state.mode == SHOW_X:
        work.z[env, place] = x[row]
        return wp.vec3d()
    r = b[row]
    if state.mode == START:
        x[row] = wp.vec3d()
    else:
        product = row_sum(env, place, layout, has_extra, extra, work.parts[env])
        if state.mode == RESTART:
            r = r - product
        else:
            p = work.p[env, place]
            q = work.q[env, place]
            z = work.z[env, place]
            r = work.r[env, place]
            done = x[row]
            if state.beta == wp.float64(0.0):
                p = z
                q = product
            else:
                p = z + state.beta * p
                q = product + state.beta * q
            work.p[env, place] = p
            work.q[env, place] = q
            x[row] = done + state.way * p
            r = r - state.alpha * q
    work.r[env, place] = r
    z = inverse * r
    work.z[env, place] = z
    return wp.vec3d(wp.dot(r, z), wp.float64(0.0), wp.dot(r, r))


@cache
def _solve_kernel(room: int) -> Any:
    """The kernel, with ``room`` numbers of shared memory."""
    address = address_of_tile(room)

    @wp.kernel(grid_stride=False, launch_bounds=(512, 1), module="unique", enable_backward=False)
    def block_cg_kernel(
        lanes: int,
        stages: int,
        active: wp.array(dtype=wp.int32),
        order: wp.array(dtype=wp.int32),
        layout: RowSlices,
        all_values: wp.array2d(dtype=wp.float64),
        all_packed: wp.array2d(dtype=wp.float32),
        extra: ExtraRows,
        extra_values: wp.array(dtype=wp.float64),
        inverses: wp.array2d(dtype=wp.mat33d),
        clusters: Clusters,
        all_stores: wp.array2d(dtype=wp.float64),
        coarse: CoarseSpace,
        rhs: wp.array2d(dtype=wp.vec3d),
        tolerances: wp.array(dtype=wp.float64),
        verify_below: wp.float64,
        max_iterations: int,
        reach: wp.float64,
        work: CgWork,
        solutions: wp.array2d(dtype=wp.vec3d),
        iterations: wp.array(dtype=wp.int32),
        residuals: wp.array(dtype=wp.float64),
        breakdowns: wp.array(dtype=wp.int32),
    ):
        env, lane = wp.tid()
        memory = address(wp.tile_empty(shape=room, dtype=wp.float64, storage="shared"))
        n = rhs.shape[1]
        x = solutions[env]
        if active[env] == 0:
            for row in range(lane, n, lanes):
                x[row] = wp.vec3d()
            if lane == 0:
                report_solve(env, CgState(), iterations, residuals, breakdowns)
            return
        owned = owned_parts(coarse, 0, 1)
        slices = layout.slices.shape[0]
        stream = open_stream(lane, lanes, 0, slices, layout, memory, stages)
        has_extra = extra.totals[env, 1] > 0
        clustered = clusters.tasks.shape[0]
        turn = int(0)
        state = new_solve()
        while state.running == 1:
            share = wp.vec3d()
            here = anew(env)
            for place in range(lane, n, lanes):
                inverse = inverses[here, place]
                share += _update_row(
                    here,
                    place,
                    order[place],
                    state,
                    layout,
                    has_extra,
                    extra,
                    rhs[here],
                    inverse,
                    work,
                    solutions[here],
                )
            if state.mode != SHOW_X and clustered + coarse.width > 0:
                block_barrier()
                here = anew(env)
                for task in range(lane, clustered, lanes):
                    r = work.r_scalars[here]
                    product = cluster_product(task, clusters, all_stores[here], r)
                    work.z_scalars[here, task] = product
                    share[0] += product * r[task]
                if coarse.width > 0:
                    here = anew(env)
                    share[0] += add_correction(
                        here,
                        owned,
                        1,
                        lane,
                        lanes,
                        coarse,
                        work.gates,
                        work.r[here],
                        work.z[here],
                    )
            here = anew(env)
            begin_stream(stream, layout, all_packed[here])
            block_barrier()
            here = anew(env)
            z = work.z_scalars[here]
            # Stiff bodies make up for little of what rounding takes from them.
            exact_rows = clustered / 3
            if state.mode == SHOW_X:
                exact_rows = n
            share[1] = multiply_streamed(
                lane,
                stream,
                exact_rows,
                layout,
                all_values[here],
                all_packed[here],
                z,
                work.parts_scalars[here],
            )
            here = anew(env)
            share[1] += multiply_extra(here, lane, lanes, extra, extra_values, work.z_scalars[here])
            sums = team_sum(share, here, 0, 1, lane, turn, work.gates, work.sums[here])
            turn = 1 - turn
            if state.mode == SHOW_X:
                state.mode = RESTART
            else:
                if state.mode == START:
                    state = state_load(state, sums[2], tolerances[here])
                verifies = tolerances[here] < verify_below
                state = next_step(state, sums, verifies, max_iterations)
        end_stream()
        if state.broken == 1:
            share = wp.vec3d()
            for row in range(lane, n, lanes):
                share += wp.vec3d(
                    wp.length_sq(x[row]), wp.dot(x[row], rhs[env, row]), wp.float64(0.0)
                )
            sums = team_sum(share, env, 0, 1, lane, turn, work.gates, work.sums[env])
            part = shortened(sums[0], sums[1], reach)
            for row in range(lane, n, lanes):
                x[row] = part * x[row]
            if part == wp.float64(0.0):
                state.count = 0
        if lane == 0:
            report_solve(env, state, iterations, residuals, breakdowns)

    return block_cg_kernel


class BlockCG:
    """CG with diagonal blocks as preconditioner, one thread block an environment."""

    def __init__(
        self,
        problem: LinearProblem,
        clusters: list[tuple[int, int]],
        lanes: int | None = None,
        part_rows: int = PART_ROWS,
    ) -> None:
        """``clusters``: ranges of rows that are stiff among themselves. ``lanes`` of the thread
        block, chosen by size when left out. ``part_rows``: see ``coarse_parts``."""
        self._problem = problem
        device, n = problem.device, problem.pattern.free_count
        groups = [np.arange(first, end) for first, end in clusters]
        parts = coarse_parts(problem, groups, part_rows)
        plan = plan_rows(n, groups, parts=parts)
        self._order = wp.array(plan.order.astype(np.int32), dtype=wp.int32, device=device)
        self._values = scalars(problem.values)
        self._packed = PackedRows(problem, plan, lanes)
        self._reach = reach_m(problem, clusters)
        self._inverses = DiagonalInverses(problem, plan, lanes)
        self._coarse = CoarseCorrection(problem, plan, parts, lanes)
        self._extra = ExtraRowLists(problem, plan, lanes)
        tasks = 3 * self._packed.layout.segment_count
        self._team = Team(team(device, problem.env_count, tasks, lanes).lanes)
        # The cache that more of them would take holds the vectors.
        self._stages = min(2, stages_of(device))
        self._kernel = _solve_kernel(room_for_stream(self._team.lanes, self._stages))
        work = self._work = CgWork()
        work.r, work.z, work.p, work.q = (
            wp.zeros(problem.shape, dtype=wp.vec3d, device=device) for _ in range(4)
        )
        sums = (problem.env_count, 2 * self._team.lanes if device.is_cpu else 1)
        work.sums = wp.zeros(sums, dtype=wp.vec3d, device=device)
        work.gates = wp.zeros(1, dtype=wp.int32, device=device)
        work.r_scalars, work.z_scalars = scalars(work.r), scalars(work.z)
        self._allocate_parts()
        self.description = (
            f"CG preconditioned by {described(groups)}{self._coarse}, one kernel, "
            f"{self._team.lanes} threads an environment"
        )

    def _allocate_parts(self) -> None:
        problem, work = self._problem, self._work
        shape = (problem.env_count, self._packed.layout.segment_count)
        work.parts = wp.zeros(shape, dtype=wp.vec3d, device=problem.device)
        work.parts_scalars = scalars(work.parts)

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
        inputs = [self._team.lanes, self._stages, active, self._order, layout, self._values]
        inputs += [self._packed.values, self._extra.rows, self._extra.values, self._inverses.blocks]
        inputs += [self._inverses.clusters, self._inverses.stores, self._coarse.space, problem.rhs]
        inputs += [problem.tolerances, wp.float64(VERIFY_BELOW), max_iterations]
        inputs += [wp.float64(self._reach), work]
        inputs += [problem.solution, problem.iterations, problem.residuals, problem.breakdown]
        launch_team(self._kernel, problem.env_count, self._team, *inputs)
