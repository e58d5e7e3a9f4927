# SPDX-License-Identifier: Apache-2.0
"""Friction within a step: frozen anew where an environment is.

Frozen friction makes the matrix symmetric and the step a minimum; freezing anew is a fixed-point
iteration. Directions by the whole derivative of friction, which no symmetric matrix has, saved some
iterations where tools are sharp, but cost solves: 43 presses took a fifth more time.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.model.env_rows import zero_rows
from taccel_lab.solvers.env_phase import FREEZING, go_on, leave, stop
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.measure import add_friction, element_rounding, measure_residual, weigh
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False})

_CONVERGED = wp.constant(int(EnvStatus.CONVERGED))
_FRICTION = wp.constant(int(EnvStatus.FRICTION))
LEAST_DAMPING = 0.125
"""Shortest step between freezings that alternate, of a whole one: what alternates by a factor of up
to fifteen shrinks along it."""


@wp.func
def next_damping(damping: wp.float64, left: wp.float64) -> wp.float64:
    """Longest step, 0 to 1, until the next freezing, after one that ``left`` this part of the
    residual.

    Where freezing alternates instead of shrinking (a node leaning on two faces in turn) the steps
    between are damped until it shrinks again. Where the residual grows along the shortest step,
    too, nothing alternates: friction does not hold what is there, and whole steps leave it soonest.
    """
    one = wp.float64(1.0)
    half = wp.float64(0.5)
    if left <= one - wp.float64(0.1) * damping:
        return wp.min(wp.float64(1.5) * damping, one)
    if damping > wp.float64(LEAST_DAMPING):
        return half * damping
    return one


@wp.kernel
def _judge_friction_kernel(elements: wp.array2d(dtype=wp.float64), p: Progress):
    """Only the residual with the friction that was frozen anew counts as converged."""
    env = wp.tid()
    if p.phases.phase[env] != FREEZING:
        return
    p.counts.lags[env] += 1
    leave(env, p)
    weigh(env, elements, p)
    excess = p.balance.excess[env]
    left = excess / wp.max(p.balance.lag_change[env], wp.float64(1.0e-300))
    p.balance.damping[env] = next_damping(p.balance.damping[env], left)
    p.balance.lag_change[env] = excess
    p.balance.last_residual[env] = wp.float64(wp.inf)
    if excess <= wp.float64(1.0):
        stop(env, _CONVERGED, p)
    elif p.counts.lags[env] >= p.rules.max_lags:
        stop(env, _FRICTION, p)
    go_on(env, p)


def refreeze_friction(run: StepLaunches) -> None:
    """Freeze friction anew in the chosen environments, and judge them by what it is then."""
    s = run.s
    assert s.friction is not None
    lag, x = s.friction.lag, run.state.positions
    gradient, inner = s.friction_gradient, run.inner
    run.together([lambda: lag(inner, x, s.origin), lambda: zero_rows(inner, gradient)])
    add_friction(run, inner)
    measure_residual(run, inner)
    run.decide(_judge_friction_kernel, element_rounding(run))
