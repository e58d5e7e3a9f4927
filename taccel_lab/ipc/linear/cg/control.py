# SPDX-License-Identifier: Apache-2.0
"""What conjugate gradients decide after the sums of an iteration: to go on, start anew, or end.

Both recurrences (``block_cg``, ``pipelined_cg``) get alpha and beta from the dot products of an
iteration at one time [Chronopoulos and Gear 1989, s-step iterative methods for symmetric linear
systems]. Every lane decides for itself, from the same sums.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.linear.problem.turned import turned_curvature

wp.set_module_options({"enable_backward": False})

# What a pass over the rows does.
START = wp.constant(0)  # r = b
SHOW_X = wp.constant(1)  # show x to the product
RESTART = wp.constant(2)  # r = b - A x, with what SHOW_X brought
FIRST = wp.constant(3)  # the first product with M^-1 r, where that takes a pass of its own
STEP = wp.constant(4)  # a step of CG


@wp.struct
class CgState:
    """Where a solve stands.

    mode: what the next pass does; count: steps so far; running, broken: flags.
    b_sq, r_sq: squares of the load and of the residual; goal: of the residual that is wanted;
    start_sq: of the one at the last start.
    alpha, beta, rho: of the last step; rho = (r, M^-1 r).
    way: alpha, turned where the curvature is negative (``problem.turned``).
    length_sq: of the direction, in the metric of the preconditioner.
    """

    mode: int
    count: int
    running: int
    broken: int
    b_sq: wp.float64
    r_sq: wp.float64
    goal: wp.float64
    start_sq: wp.float64
    alpha: wp.float64
    beta: wp.float64
    rho: wp.float64
    way: wp.float64
    length_sq: wp.float64


@wp.func
def new_solve() -> CgState:
    """State before the first pass."""
    state = CgState()
    state.mode = START
    state.running = 1
    state.start_sq = wp.float64(wp.inf)
    state.alpha = wp.float64(1.0)
    state.rho = wp.float64(1.0)
    return state


@wp.func
def state_load(state: CgState, b_sq: wp.float64, tolerance: wp.float64) -> CgState:
    """State after the first pass: the load, and how small the residual has to become."""
    state.b_sq = b_sq
    state.r_sq = b_sq
    state.goal = tolerance * tolerance * b_sq
    return state


@wp.func
def next_step(state: CgState, sums: wp.vec3d, verifies: bool, max_iterations: int) -> CgState:
    """State after the sums (r, u), (w, u) and (r, r), with u = M^-1 r and w = A u. ``verifies``:
    whether the residual that the recurrence updates is believed only after a fresh start."""
    zero = wp.float64(0.0)
    infinity = wp.float64(wp.inf)
    fresh = state.mode != STEP
    last_start_sq = state.start_sq
    limit = state.goal
    state.r_sq = sums[2]
    state.beta = sums[0] / state.rho
    if fresh:
        state.beta = zero
        state.start_sq = state.r_sq
        # A true residual may miss by a thousandth: not worth a fresh start.
        limit = wp.float64(1.001) * limit
    curvature = sums[1] - state.beta * sums[0] / state.alpha
    state.alpha = sums[0] / curvature
    state.length_sq = sums[0] + state.beta * state.beta * state.length_sq
    state.way = sums[0] / turned_curvature(curvature, state.length_sq)
    state.rho = sums[0]
    state.mode = STEP
    finite = state.r_sq < infinity
    sound = state.rho > zero and curvature > zero and curvature < infinity and finite
    turns = state.rho > zero and curvature != zero and wp.isfinite(curvature) and finite
    whole = state.broken == 0
    if finite and state.r_sq <= limit:
        if whole and verifies and not fresh and state.count < max_iterations:
            # What the rounding of the recurrence left is solved for in a fresh start.
            state.mode = SHOW_X
        else:
            state.running = 0
    elif fresh and state.r_sq > wp.float64(0.25) * last_start_sq:
        # Starting anew did not help the last time.
        state.broken = 1
        state.running = 0
    elif whole and not sound and not fresh and state.r_sq < wp.float64(1e-6) * state.b_sq:
        # As close as this, it may well be rounding that spoils the curvature.
        state.mode = SHOW_X
    elif not turns:
        state.broken = 1
        state.running = 0
    elif state.count >= max_iterations:
        state.running = 0
    else:
        state.count += 1
        if not sound:
            state.broken = 1
    return state


@wp.func
def report_solve(
    env: int,
    state: CgState,
    iterations: wp.array(dtype=wp.int32),
    residuals: wp.array(dtype=wp.float64),
    breakdowns: wp.array(dtype=wp.int32),
):
    """Write what a solve took and reached; by one lane. Of an empty state zeros."""
    iterations[env] = state.count
    breakdowns[env] = state.broken
    if state.b_sq == wp.float64(0.0):
        residuals[env] = wp.float64(0.0)
    elif state.count == 0:
        residuals[env] = wp.float64(1.0)
    else:
        residuals[env] = wp.sqrt(state.r_sq / state.b_sq)
