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

import numpy as np
import warp as wp

from taccel_lab.ipc.branches import side_by_side
from taccel_lab.ipc.linear.block_ops import Team, block_barrier, launch_team, team, team_sum
from taccel_lab.ipc.linear.coarse_matrix import PART_ROWS, CoarseCorrection, coarse_parts
from taccel_lab.ipc.linear.coarse_space import CoarseSpace, add_correction, owned_parts
from taccel_lab.ipc.linear.extra_rows import ExtraRowLists, ExtraRows
from taccel_lab.ipc.linear.packed_rows import PackedRows, RowSlices
from taccel_lab.ipc.linear.preconditioner import (
    Clusters,
    DiagonalInverses,
    cluster_product,
    described,
)
from taccel_lab.ipc.linear.problem import LinearProblem
from taccel_lab.ipc.linear.row_lists import scalars
from taccel_lab.ipc.linear.row_plan import plan_rows
from taccel_lab.ipc.linear.row_products import multiply_extra, multiply_fixed, row_sum

wp.set_module_options({"enable_backward": False})

VERIFY_BELOW = 1e-8
"""Tolerance from which on the true residual is checked and CG started anew where it falls short:
its own, which it updates, has drifted by less than 1e-10."""


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


# What the rows of a pass over the vectors do before they are preconditioned.
_START = wp.constant(0)  # r = b
_STEP = wp.constant(1)  # a step of CG
_SHOW_X = wp.constant(2)  # z = x, to multiply that
_RESTART = wp.constant(3)  # r = b - A x, with what _SHOW_X brought


@wp.func
def _update_row(
    env: int,
    place: int,
    row: int,
    mode: int,
    alpha: wp.float64,
    beta: wp.float64,
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
    if mode == _SHOW_X:
        work.z[env, place] = x[row]
        return wp.vec3d()
    r = b[row]
    if mode == _START:
        x[row] = wp.vec3d()
    else:
        product = row_sum(env, place, layout, has_extra, extra, work.parts[env])
        if mode == _RESTART:
            r = r - product
        else:
            p = work.p[env, place]
            q = work.q[env, place]
            z = work.z[env, place]
            r = work.r[env, place]
            done = x[row]
            if beta == wp.float64(0.0):
                p = z
                q = product
            else:
                p = z + beta * p
                q = product + beta * q
            work.p[env, place] = p
            work.q[env, place] = q
            x[row] = done + alpha * p
            r = r - alpha * q
    work.r[env, place] = r
    z = inverse * r
    work.z[env, place] = z
    return wp.vec3d(wp.dot(r, z), wp.float64(0.0), wp.dot(r, r))


@wp.kernel(grid_stride=False, launch_bounds=(512, 2))
def _solve_kernel(
    lanes: int,
    active: wp.array(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
    layout: RowSlices,
    all_packed: wp.array2d(dtype=wp.float64),
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
    work: CgWork,
    solutions: wp.array2d(dtype=wp.vec3d),
    iterations: wp.array(dtype=wp.int32),
    residuals: wp.array(dtype=wp.float64),
    breakdowns: wp.array(dtype=wp.int32),
):
    env, lane = wp.tid()
    n = rhs.shape[1]
    zero = wp.float64(0.0)
    infinity = wp.float64(wp.inf)
    x = solutions[env]
    if active[env] == 0:
        for row in range(lane, n, lanes):
            x[row] = wp.vec3d()
        if lane == 0:
            iterations[env] = 0
            residuals[env] = zero
            breakdowns[env] = 0
        return
    b = rhs[env]
    owned = owned_parts(coarse, 0, 1)
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
        for place in range(lane, n, lanes):
            inverse = inverses[env, place]
            share += _update_row(
                env,
                place,
                order[place],
                mode,
                alpha,
                beta,
                layout,
                has_extra,
                extra,
                b,
                inverse,
                work,
                x,
            )
        clustered = clusters.tasks.shape[0]
        if mode != _SHOW_X and clustered > 0:
            block_barrier()
            for task in range(lane, clustered, lanes):
                product = cluster_product(task, clusters, all_stores[env], work.r_scalars[env])
                work.z_scalars[env, task] = product
                share[0] += product * work.r_scalars[env, task]
        if mode != _SHOW_X and coarse.width > 0:
            share[0] += add_correction(
                env,
                owned,
                1,
                lane,
                lanes,
                coarse,
                work.gates,
                work.r[env],
                work.z[env],
            )
        block_barrier()
        end = 3 * layout.segments.shape[0]
        z = work.z_scalars[env]
        parts = work.parts_scalars[env]
        share[1] = multiply_fixed(lane, end, lanes, layout, all_packed[env], z, parts)
        share[1] += multiply_extra(env, lane, lanes, extra, extra_values, z)
        total = team_sum(share, env, 0, 1, lane, turn, work.gates, work.sums[env])
        turn = 1 - turn
        if mode == _SHOW_X:
            mode = int(_RESTART)
        else:
            fresh = mode != _STEP
            if mode == _START:
                b_sq = total[2]
                goal = tolerances[env] * tolerances[env] * b_sq
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
    if lane == 0:
        iterations[env] = count
        breakdowns[env] = broken
        if b_sq == zero:
            residuals[env] = zero
        elif count == 0:
            residuals[env] = wp.float64(1.0)
        else:
            residuals[env] = wp.sqrt(r_sq / b_sq)


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
        self._inverses = DiagonalInverses(problem, plan, lanes)
        self._coarse = CoarseCorrection(problem, plan, parts, lanes)
        self._extra = ExtraRowLists(problem, plan, lanes)
        tasks = 3 * self._packed.layout.segment_count
        self._team = Team(team(device, problem.env_count, tasks, lanes).lanes)
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
        launch_team(
            _solve_kernel,
            problem.env_count,
            self._team,
            [self._team.lanes, active, self._order, layout, self._packed.values]
            + [self._extra.rows, self._extra.values]
            + [self._inverses.blocks, self._inverses.clusters, self._inverses.stores]
            + [self._coarse.space]
            + [problem.rhs, problem.tolerances, wp.float64(VERIFY_BELOW), max_iterations, work],
            [problem.solution, problem.iterations, problem.residuals, problem.breakdown],
            problem.device,
        )
