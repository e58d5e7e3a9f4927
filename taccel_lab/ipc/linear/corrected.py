# SPDX-License-Identifier: Apache-2.0
"""Systems (H + C) p = rhs whose correction C is neither stored nor symmetric.

The solver of H, which is symmetric, serves as the preconditioner: a solution z of H z = r changes
the residual by r + C z, up to the tolerance of that solve. Generalised conjugate residuals
[Eisenstat, Elman and Schultz 1983, Variational iterative methods for nonsymmetric systems of linear
equations] take the combination of all z so far that leaves the smallest residual.
"""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from taccel_lab.ipc.device.sums import BLOCK_THREADS, block_total
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.model.launches import launch, launch_blocks

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})

MOST_SOLVES = 8
"""Solves with H for one direction."""
TOLERANCE = 0.05
"""Residual over load that is left."""


@wp.struct
class Combination:
    """What a combination is made of, by environment.

    directions, answers: solutions, and how they change the residual, made orthonormal; shape
    [env_count, MOST_SOLVES, free_count]. taken: the best combination [env_count, free_count].
    counts: solutions so far. loads: squares of the right-hand sides.
    """

    directions: wp.array3d(dtype=wp.vec3d)
    answers: wp.array3d(dtype=wp.vec3d)
    taken: wp.array2d(dtype=wp.vec3d)
    counts: wp.array(dtype=wp.int32)
    loads: wp.array(dtype=wp.float64)


@wp.kernel
def _begin_combination_kernel(
    who: wp.array(dtype=wp.int32),
    renewed: wp.array(dtype=wp.int32),
    solving: wp.array(dtype=wp.int32),
    c: Combination,
):
    """Nothing is combined yet; the matrix stays, and what was made for it serves on."""
    env = wp.tid()
    solving[env] = who[env]
    c.counts[env] = 0
    if who[env] != 0:
        renewed[env] = 0


@wp.kernel
def _combine_kernel(
    solving: wp.array(dtype=wp.int32),
    solutions: wp.array2d(dtype=wp.vec3d),
    changes: wp.array2d(dtype=wp.vec3d),
    breakdown: wp.array(dtype=wp.int32),
    iterations: wp.array(dtype=wp.int32),
    most: int,
    tolerance: wp.float64,
    residuals: wp.array2d(dtype=wp.vec3d),
    c: Combination,
    totals: wp.array(dtype=wp.int32),
    going: wp.array(dtype=wp.int32),
):
    """Add the solution of a system whose right-hand side was the residual. One thread block an
    environment; each thread has rows of its own."""
    env, lane = wp.tid()
    if solving[env] == 0:
        return
    last = c.counts[env]
    rows = residuals.shape[1]
    zero = wp.float64(0.0)
    before = wp.float64(0.0)
    for i in range(lane, rows, wp.block_dim()):
        r = residuals[env, i]
        before += wp.dot(r, r)
        c.directions[env, last, i] = solutions[env, i]
        c.answers[env, last, i] = r + changes[env, i]
        if last == 0:
            c.taken[env, i] = wp.vec3d()
    left = block_total(before)
    for k in range(last):
        shared = wp.float64(0.0)
        for i in range(lane, rows, wp.block_dim()):
            shared += wp.dot(c.answers[env, last, i], c.answers[env, k, i])
        share = block_total(shared)
        for i in range(lane, rows, wp.block_dim()):
            c.answers[env, last, i] = c.answers[env, last, i] - share * c.answers[env, k, i]
            c.directions[env, last, i] = (
                c.directions[env, last, i] - share * c.directions[env, k, i]
            )
    square = wp.float64(0.0)
    along = wp.float64(0.0)
    for i in range(lane, rows, wp.block_dim()):
        answer = c.answers[env, last, i]
        square += wp.dot(answer, answer)
        along += wp.dot(answer, residuals[env, i])
    size_sq = block_total(square)
    reach = block_total(along)
    # Where the matrix of H turned out not to be positive definite the solution is none.
    useful = breakdown[env] == 0 and size_sq > zero and wp.isfinite(size_sq)
    if useful:
        scale = wp.float64(1.0) / wp.sqrt(size_sq)
        part = reach * scale
        for i in range(lane, rows, wp.block_dim()):
            direction = scale * c.directions[env, last, i]
            answer = scale * c.answers[env, last, i]
            c.directions[env, last, i] = direction
            c.answers[env, last, i] = answer
            c.taken[env, i] = c.taken[env, i] + part * direction
            residuals[env, i] = residuals[env, i] - part * answer
    if lane == 0:
        if last == 0:
            c.loads[env] = left
        else:
            totals[env] += iterations[env]
        if useful:
            left -= reach * reach / size_sq
        c.counts[env] = last + 1
        if useful and last + 1 < most and left > tolerance * tolerance * c.loads[env]:
            going[0] = 1
        else:
            solving[env] = 0


@wp.kernel
def _take_combination_kernel(
    who: wp.array(dtype=wp.int32), c: Combination, solutions: wp.array2d(dtype=wp.vec3d)
):
    env, row = wp.tid()
    if who[env] != 0:
        solutions[env, row] = c.taken[env, row]


class CorrectedSolve:
    """Solutions of the corrected systems of a solver, from those that it solves."""

    def __init__(self, linear: LinearSystem) -> None:
        self._linear = linear
        count, rows = linear.shape
        device = linear.device
        self.changes = wp.zeros(linear.shape, dtype=wp.vec3d, device=device)
        """C times the present solution [N], written by ``change`` of ``solve``."""
        self._solving = wp.zeros(count, dtype=wp.int32, device=device)
        self._going = wp.zeros(1, dtype=wp.int32, device=device)
        c = self._combination = Combination()
        shape = (count, MOST_SOLVES, rows)
        c.directions = linear.scratch.take(shape, wp.vec3d, device)
        c.answers = linear.scratch.take(shape, wp.vec3d, device)
        c.taken = wp.zeros(linear.shape, dtype=wp.vec3d, device=device)
        c.counts = wp.zeros(count, dtype=wp.int32, device=device)
        c.loads = wp.zeros(count, dtype=wp.float64, device=device)

    def solve(
        self,
        who: wp.array,
        change: Callable[[wp.array], None],
        max_iterations: int,
        totals: wp.array,
    ) -> None:
        """Bring the solution of H p = rhs in the environments of ``who`` (int32, [env_count]) to
        that of (H + C) p = rhs, to ``TOLERANCE`` or in ``MOST_SOLVES``; ``rhs`` becomes what is
        left. ``change`` writes ``changes`` in the environments of a mask that it is given; CG
        iterations are added to ``totals``."""
        linear, c = self._linear, self._combination
        launch(_begin_combination_kernel, len(who), who, linear.renewed, self._solving, c)

        def solve_again() -> None:
            linear.solve(self._solving, max_iterations)

        def improve() -> None:
            change(self._solving)
            self._going.zero_()
            inputs = [self._solving, linear.solution, self.changes, linear.breakdown]
            inputs += [linear.iterations, MOST_SOLVES, wp.float64(TOLERANCE), linear.rhs, c, totals]
            launch_blocks(_combine_kernel, len(self._solving), *inputs, self._going)
            wp.capture_if(self._going, on_true=solve_again)

        improve()
        wp.capture_while(self._going, improve)
        launch(_take_combination_kernel, linear.shape, who, c, linear.solution)
