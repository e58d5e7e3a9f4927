# SPDX-License-Identifier: Apache-2.0
"""Stage 5 of an iteration: forces, residual, and whether an environment has converged."""

from __future__ import annotations

import warp as wp

from taccel_lab.model.env_lists import EnvMask
from taccel_lab.solvers.env_phase import (
    CLOSING,
    FREEZING,
    SEARCHING,
    enter,
    forget_gain,
    go_on,
    leave,
    stop,
)
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.friction_lag import refreeze_friction
from taccel_lab.solvers.measure import bound_rounding, element_rounding, evaluate_gradient, weigh
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False})

_CONVERGED = wp.constant(int(EnvStatus.CONVERGED))
_NOT_A_NUMBER = wp.constant(int(EnvStatus.NOT_A_NUMBER))
_JOINT = wp.constant(int(EnvStatus.JOINT))
_TOUCHING = wp.constant(int(EnvStatus.TOUCHING))
FREEZE_BELOW = 0.3
"""Part of the last change by freezing, and of the contact force, to which the residual has to fall
before friction is frozen anew."""


@wp.func
def settle(env: int, p: Progress):
    """Stop what has converged; with friction, choose where it is frozen anew.

    Not where joints are open. While freezing anew still changes forces, solving in between to the
    last digit is wasted: ``FREEZE_BELOW`` of the last change is enough, and one step when damped.
    At first friction waits for as small a part of the contact force: frames on their way squeeze
    what lies ahead, up to 34 times as much as in the end, and friction frozen then holds it there.
    """
    if p.phases.active[env] != 0:
        settled = p.prescribed.progress[env] >= wp.float64(1.0) and p.phases.phase[env] != CLOSING
        leave(env, p)
        if settled:
            enough = wp.float64(1.0)
            if p.rules.has_friction == 0:
                if p.balance.excess[env] <= enough:
                    stop(env, _CONVERGED, p)
            else:
                change = wp.min(p.balance.lag_change[env], enough / p.rules.relative_tolerance)
                enough = wp.max(enough, wp.float64(FREEZE_BELOW) * change)
                if p.balance.damping[env] < wp.float64(1.0):
                    enough = wp.float64(wp.inf)
                if p.balance.excess[env] <= enough:
                    enter(env, FREEZING, p)
                    p.flags.freezing[0] = 1


@wp.func
def judge(env: int, elements: wp.array2d(dtype=wp.float64), p: Progress):
    """See ``_judge_kernel``."""
    leave(env, p)
    weigh(env, elements, p)
    if not (p.balance.min_distance[env] > wp.float64(0.0)):
        stop(env, _TOUCHING, p)
    elif not wp.isfinite(p.balance.residual[env]):
        stop(env, _NOT_A_NUMBER, p)
    elif p.rules.has_joints != 0:
        one = wp.float64(1.0)
        if p.prescribed.progress[env] >= one and p.balance.excess[env] <= one:
            enter(env, CLOSING, p)
            p.flags.closing[0] = 1
    else:
        settle(env, p)


@wp.kernel
def _judge_kernel(
    mask: wp.array(dtype=wp.int32), last: int, elements: wp.array2d(dtype=wp.float64), p: Progress
):
    """Stop what cannot go on; with joints, choose the environments whose are to be looked at.

    ``last``: without joints, all that follows is decided at once.
    """
    env = wp.tid()
    if p.phases.active[env] != 0 and mask[env] != 0 and p.phases.phase[env] != SEARCHING:
        judge(env, elements, p)
    if last != 0:
        go_on(env, p)


@wp.kernel
def _judge_joints_kernel(violations: wp.array(dtype=wp.float64), p: Progress):
    """Where Newton has converged: those whose joints are not open go on."""
    env = wp.tid()
    if p.phases.phase[env] != CLOSING:
        return
    p.balance.violation[env] = violations[env]
    if not (violations[env] > p.rules.joint_tolerance):
        leave(env, p)
        return
    p.counts.joint_rounds[env] += 1
    p.flags.reopened[0] = 1
    forget_gain(env, p)
    if p.counts.joint_rounds[env] > p.rules.max_joint_rounds:
        stop(env, _JOINT, p)


@wp.kernel
def _settle_kernel(
    mask: wp.array(dtype=wp.int32), elements: wp.array2d(dtype=wp.float64), p: Progress
):
    """Settles environments after the joints were looked at."""
    env = wp.tid()
    if p.phases.active[env] != 0 and mask[env] != 0 and p.phases.phase[env] != SEARCHING:
        weigh(env, elements, p)
        settle(env, p)
    go_on(env, p)


def measure_and_judge(run: StepLaunches, mask: EnvMask, take_trial: bool = False) -> None:
    """Forces and residual of the environments of ``mask`` whose line search is over; those that
    have finished stop. ``take_trial``: where it has led."""
    s, p = run.s, run.p
    if not take_trial:
        bound_rounding(run)
    evaluate_gradient(run, run.stepping if take_trial else mask, take_trial)
    elements = element_rounding(run)
    run.decide(_judge_kernel, mask, int(s.joints is None), elements)
    if s.joints is not None:
        wp.capture_if(p.flags.closing, on_true=lambda: _close_joints(run))
        run.decide(_settle_kernel, mask, elements)
    if s.friction is not None:
        wp.capture_if(p.flags.freezing, on_true=lambda: refreeze_friction(run))


def _close_joints(run: StepLaunches) -> None:
    """Where Newton has converged, correct the joint forces until the joints are closed."""
    s, p = run.s, run.p
    assert s.joints is not None
    s.joints.update_multipliers(p.phases.inner, run.state.positions)
    run.decide(_judge_joints_kernel, s.joints.violations)
    wp.capture_if(p.flags.reopened, on_true=lambda: evaluate_gradient(run, run.inner))
