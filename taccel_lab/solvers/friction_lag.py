# SPDX-License-Identifier: Apache-2.0
"""Friction within a step: frozen anew where an environment is, or followed by the direction.

Frozen friction makes the matrix symmetric and the step a minimum; freezing anew is a fixed-point
iteration. Where edges rub it leaves 0.92 of the residual each time, or alternates. Once a freezing
was slow, friction is frozen where an environment is, and the residual has come down to a part of
the contact force, the direction is that of the whole derivative instead (``friction_change``),
which leaves a tenth of the residual near the solution. ``CorrectedSolve`` finds it by systems with
frozen friction. No energy falls along it: only the residual with friction frozen where it led says
whether it led anywhere. If not, a quarter of it is tried, and then none.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.motion.unknowns import reduce_gradient, spread_solution
from taccel_lab.ipc.potentials.friction_change import add_friction_change
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.env_rows import copy_rows, zero_rows
from taccel_lab.model.launches import launch
from taccel_lab.solvers.env_phase import FREEZING, RETREATING, enter, go_on, leave, stop
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.measure import (
    add_friction,
    element_rounding,
    evaluate_gradient,
    measure_residual,
    weigh,
)
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False})


SLOW = 0.3
"""Part of the residual that some freezing of the step has left where directions follow friction.
Those cost several solves, and under balls freezing leaves less."""
FOLLOW_BELOW = 0.1
"""Residual over contact force below which directions follow friction."""


@wp.func
def follows_friction(env: int, p: Progress):
    """Choose whether the next direction follows friction: where that is frozen at the positions,
    and matrices are not projected. With joints it does not: their forces have rounds of their own.
    """
    if (
        p.rules.has_friction == 0
        or p.rules.has_joints != 0
        or p.counts.lags[env] < p.rules.follow_after
    ):
        return
    if p.following.left[env] < wp.float64(SLOW):
        return
    if p.following.pause[env] > 0:
        p.following.pause[env] -= 1
        return
    if p.prescribed.progress[env] < wp.float64(1.0) or p.curvature.projected[env] > 0:
        return
    if wp.isfinite(p.balance.last_residual[env]):
        return
    if p.rules.relative_tolerance * p.balance.excess[env] < wp.float64(FOLLOW_BELOW):
        p.following.follows[env] = 1
        p.following.seeks[env] = 1
        p.following.share[env] = wp.float64(1.0)
        p.following.excess_before[env] = p.balance.excess[env]


def follow_friction(run: StepLaunches) -> None:
    """Turn the directions with frozen friction, where they shall follow it, into those of the whole
    derivative."""
    s, p = run.s, run.p
    assert s.friction is not None and s.corrected is not None
    friction, corrected, displacements = s.friction, s.corrected, s.displacements
    seeks = p.following.seeks
    copy_rows(seeks, run.state.positions, s.follow_start)

    def change(mask: wp.array) -> None:
        spread_solution(run.model, mask, s.linear.solution, displacements)
        zero_rows(mask, s.friction_change)
        sharpness = p.curvature.sharpness
        add_friction_change(
            friction, mask, run.motion(), sharpness, displacements, s.friction_change
        )
        reduce_gradient(run.model, mask, [s.friction_change], corrected.changes)

    corrected.solve(seeks, change, s.config.max_cg_iterations, p.counts.cg)
    spread_solution(run.model, seeks, s.linear.solution, displacements)


_CONVERGED = wp.constant(int(EnvStatus.CONVERGED))
_FRICTION = wp.constant(int(EnvStatus.FRICTION))
SHARE = 0.25
"""Part of such a step that is tried where all of it led nowhere."""
PAUSE = 2
"""Iterations with frozen friction after one that led nowhere."""


@wp.func
def retreats(env: int, p: Progress) -> bool:
    """Whether a step that followed friction is taken back: a part of it, or all."""
    if p.following.follows[env] == 0:
        return False
    if p.following.share[env] == wp.float64(0.0):
        p.following.pause[env] = PAUSE
        return False
    if p.balance.excess[env] < p.following.excess_before[env]:
        return False
    share = wp.float64(SHARE)
    if p.following.share[env] < wp.float64(1.0):
        share = wp.float64(0.0)
    p.following.share[env] = share
    enter(env, RETREATING, p)
    p.flags.retreating[0] = 1
    return True


@wp.kernel
def _judge_friction_kernel(elements: wp.array2d(dtype=wp.float64), p: Progress):
    """Only the residual with the friction that was frozen anew counts as converged.

    Freezing is a fixed-point iteration. Where it alternates instead of shrinking (a node leaning on
    two faces in turn) the steps between are damped until it shrinks again.
    """
    env = wp.tid()
    if p.phases.phase[env] < FREEZING:
        return
    if p.phases.phase[env] == FREEZING:
        p.counts.lags[env] += 1
    leave(env, p)
    one = wp.float64(1.0)
    weigh(env, elements, p)
    if retreats(env, p):
        return
    excess = p.balance.excess[env]
    damping = p.balance.damping[env]
    if p.following.follows[env] == 0:
        p.following.left[env] = wp.max(p.following.left[env], excess / p.balance.lag_change[env])
    if p.following.follows[env] != 0:
        p.balance.damping[env] = one
    elif excess > (one - wp.float64(0.1) * damping) * p.balance.lag_change[env]:
        p.balance.damping[env] = wp.max(wp.float64(0.5) * damping, wp.float64(0.05))
    else:
        p.balance.damping[env] = wp.min(wp.float64(1.5) * damping, one)
    p.balance.lag_change[env] = excess
    p.balance.last_residual[env] = wp.float64(wp.inf)
    if excess <= one:
        stop(env, _CONVERGED, p)
    elif p.counts.lags[env] >= p.rules.max_lags:
        stop(env, _FRICTION, p)
    go_on(env, p)


@wp.kernel
def _retreat_kernel(
    trial: wp.array2d(dtype=wp.vec3d),
    start: wp.array2d(dtype=wp.vec3d),
    positions: wp.array2d(dtype=wp.vec3d),
    p: Progress,
):
    """Positions between the start of a step and where it led."""
    env, node = wp.tid()
    if env == 0 and node == 0:
        p.flags.retreating[0] = 0
    if p.phases.phase[env] == RETREATING:
        displacement = trial[env, node] - start[env, node]
        positions[env, node] = start[env, node] + p.following.share[env] * displacement


def refreeze_friction(run: StepLaunches) -> None:
    """Freeze friction anew in the chosen environments, and judge them by what it is then."""
    s, p = run.s, run.p
    assert s.friction is not None
    lag, x = s.friction.lag, run.state.positions
    gradient, inner = s.friction_gradient, run.inner
    run.together([lambda: lag(inner, x, s.origin), lambda: zero_rows(inner, gradient)])
    add_friction(run, inner)
    measure_residual(run, inner)
    run.decide(_judge_friction_kernel, element_rounding(run))
    wp.capture_while(p.flags.retreating, lambda: _retreat(run))


def _retreat(run: StepLaunches) -> None:
    """Go back where a step that followed friction led nowhere. The way back is free: the way there
    was. Frames stay: such steps begin when they have arrived."""
    s, p, state = run.s, run.p, run.state
    assert s.friction is not None
    x, mask = state.positions, run.inner
    launch(_retreat_kernel, x.shape, s.trial, s.follow_start, x, p.struct)
    # Between two calls all vertices are embedded: a bit of difference, if they were not before.
    embed_vertices(run.model, x)
    run.collide(mask, x)
    s.friction.lag(mask, x, s.origin)
    evaluate_gradient(run, mask)
    run.energy(mask, x, state.poses, p.search.base, p.search.before)
    run.decide(_judge_friction_kernel, element_rounding(run))
