# SPDX-License-Identifier: Apache-2.0
"""Stage 5 of an iteration: forces, residual, and whether an environment has converged."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.sums import force_sums
from taccel_lab.ipc.motion.unknowns import reduce_gradient
from taccel_lab.ipc.potentials.elements.data import ElementSum
from taccel_lab.model.env_rows import zero_rows
from taccel_lab.solvers.env_phase import CLOSING, FREEZING, enter, leave, stop
from taccel_lab.solvers.env_progress import Balance, Counts, Flags, Phases, Prescribed, Rules
from taccel_lab.solvers.report import EnvStatus
from taccel_lab.solvers.step_launches import StepLaunches

wp.set_module_options({"enable_backward": False})

_CONVERGED = wp.constant(int(EnvStatus.CONVERGED))
_NO_CONVERGENCE = wp.constant(int(EnvStatus.NO_CONVERGENCE))
_NOT_A_NUMBER = wp.constant(int(EnvStatus.NOT_A_NUMBER))
_FRICTION = wp.constant(int(EnvStatus.FRICTION))
_JOINT = wp.constant(int(EnvStatus.JOINT))
_TOUCHING = wp.constant(int(EnvStatus.TOUCHING))
FREEZE_BELOW = 0.3
"""Part of the last change by freezing, or in a first contact of the contact force, to which the
residual has to fall before friction is frozen anew."""


@wp.func
def weigh(
    env: int,
    elements: wp.array2d(dtype=wp.float64),
    balance: Balance,  # out
    r: Rules,
):
    """Find the largest force residual of a body, the largest one over what is allowed that body (at
    most 1 where all have converged), and the contact force of the environment.

    Residual and contact force are sums of magnitudes both, over the same body: the resultant on it
    is in doubt by no more than the part of its contact force that the tolerance says, however large
    the forces on other bodies are, and however fine the mesh is. What rounding alone makes of the
    residual is allowed: ``elements`` says how much of it comes from those of each body [N],
    [env_count, body_count], where they are stiff.
    """
    total = wp.float64(0.0)
    for body in range(balance.body_forces.shape[1]):
        total += balance.body_forces[env, body]
    # Action and reaction: half of the sum over both sides of all contacts.
    total = wp.float64(0.5) * total
    shared = r.affine_rounding + balance.rounding[env]
    residual = wp.float64(0.0)
    excess = wp.float64(0.0)
    for body in range(balance.body_forces.shape[1]):
        found = balance.body_residuals[env, body]
        force = balance.body_forces[env, body]
        rounding = wp.float64(shared)
        if elements:
            rounding += elements[env, body]
        for gel in range(balance.carriers.shape[0]):
            # What presses on a gel presses on the body that carries it.
            if balance.carriers[gel] == body:
                force += balance.body_forces[env, gel]
                if elements:
                    rounding += elements[env, gel]
        force = wp.min(force, total)
        allowed = wp.max(r.absolute_tolerance, r.relative_tolerance * force)
        ratio = found / wp.max(allowed, rounding)
        # What is not a number is worse than anything, and stays.
        if not (found <= residual) and not wp.isnan(residual):
            residual = found
        if not (ratio <= excess) and not wp.isnan(excess):
            excess = ratio
    balance.contact_force[env] = total
    balance.residual[env] = residual
    balance.excess[env] = excess


@wp.kernel
def _begin_gradient_kernel(
    mask: wp.array(dtype=wp.int32),
    take_trial: int,
    trial: wp.array2d(dtype=wp.vec3d),
    trial_poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),  # out
    poses: wp.array2d(dtype=wp.transformd),  # out
    gradient: wp.array2d(dtype=wp.vec3d),  # out
    contact_gradient: wp.array2d(dtype=wp.vec3d),  # out
    friction_gradient: wp.array2d(dtype=wp.vec3d),  # out
    balance: Balance,  # out
):
    """Nothing is added up yet; positions and poses become those of the trial, or stay."""
    env, i = wp.tid()
    if mask[env] == 0:
        return
    if take_trial != 0:
        if i < positions.shape[1]:
            positions[env, i] = trial[env, i]
        if i < poses.shape[1]:
            poses[env, i] = trial_poses[env, i]
    if i < gradient.shape[1]:
        gradient[env, i] = wp.vec3d()
        contact_gradient[env, i] = wp.vec3d()
        if friction_gradient:
            friction_gradient[env, i] = wp.vec3d()
    if i == 0:
        balance.min_distance[env] = wp.float64(wp.inf)


@wp.func
def go_on(
    env: int,
    phases: Phases,  # out
    counts: Counts,
    flags: Flags,  # out
    r: Rules,
):
    """Stop where the iterations are used up; ``running`` says whether anything goes on. Not where
    friction is frozen anew first."""
    if phases.active[env] != 0 and phases.phase[env] != FREEZING:
        if counts.newton[env] >= r.max_newton:
            stop(env, _NO_CONVERGENCE, phases)
        elif flags.rounds[0] < flags.most_rounds[0]:
            flags.running[0] = 1


@wp.func
def settle(
    env: int,
    phases: Phases,  # out
    prescribed: Prescribed,
    balance: Balance,
    flags: Flags,  # out
    r: Rules,
):
    """Stop what has converged; with friction, choose where it is frozen anew.

    Not where joints are open. While freezing anew still changes forces, solving in between to the
    last digit is wasted: ``FREEZE_BELOW`` of the last change is enough, and one step when damped.
    In a first contact friction waits for as small a part of the contact force: frames on their way
    squeeze what lies ahead, and friction frozen then holds it there.
    """
    if phases.active[env] != 0:
        settled = prescribed.progress[env] >= wp.float64(1.0) and phases.phase[env] != CLOSING
        leave(env, phases)
        if settled:
            enough = wp.float64(1.0)
            if r.has_friction == 0:
                if balance.excess[env] <= enough:
                    stop(env, _CONVERGED, phases)
            else:
                change = balance.lag_change[env]
                if balance.untouched[env] != 0:
                    change = wp.min(change, enough / r.relative_tolerance)
                enough = wp.max(enough, wp.float64(FREEZE_BELOW) * change)
                if balance.excess[env] <= enough or balance.damping[env] < wp.float64(1.0):
                    enter(env, FREEZING, phases)
                    flags.freezing[0] = 1


@wp.func
def judge(
    env: int,
    elements: wp.array2d(dtype=wp.float64),
    phases: Phases,  # out
    counts: Counts,
    prescribed: Prescribed,
    balance: Balance,  # out
    flags: Flags,  # out
    r: Rules,
):
    """See ``_judge_kernel``."""
    leave(env, phases)
    weigh(env, elements, balance, r)
    if counts.newton[env] == 0:
        balance.untouched[env] = int(balance.contact_force[env] == wp.float64(0.0))
    if not (balance.min_distance[env] > wp.float64(0.0)):
        stop(env, _TOUCHING, phases)
    elif not wp.isfinite(balance.residual[env]):
        stop(env, _NOT_A_NUMBER, phases)
    elif r.has_joints != 0:
        if prescribed.progress[env] >= wp.float64(1.0) and balance.excess[env] <= wp.float64(1.0):
            enter(env, CLOSING, phases)
            flags.closing[0] = 1
    else:
        settle(env, phases, prescribed, balance, flags, r)


@wp.kernel
def _judge_kernel(
    mask: wp.array(dtype=wp.int32),
    last: int,
    elements: wp.array2d(dtype=wp.float64),
    phases: Phases,  # out
    counts: Counts,
    prescribed: Prescribed,
    balance: Balance,  # out
    flags: Flags,  # out
    r: Rules,
):
    """Stop what cannot go on; with joints, choose the environments whose are to be looked at.

    ``last``: without joints, all that follows is decided at once.
    """
    env = wp.tid()
    if phases.active[env] != 0 and mask[env] != 0:
        judge(env, elements, phases, counts, prescribed, balance, flags, r)
    if last != 0:
        go_on(env, phases, counts, flags, r)


@wp.kernel
def _judge_joints_kernel(
    violations: wp.array(dtype=wp.float64),
    phases: Phases,  # out
    counts: Counts,  # out
    balance: Balance,  # out
    flags: Flags,  # out
    r: Rules,
):
    """Where Newton has converged: those whose joints are not open go on."""
    env = wp.tid()
    if phases.phase[env] != CLOSING:
        return
    balance.violation[env] = violations[env]
    if not (violations[env] > r.joint_tolerance):
        leave(env, phases)
        return
    counts.joint_rounds[env] += 1
    flags.reopened[0] = 1
    if counts.joint_rounds[env] > r.max_joint_rounds:
        stop(env, _JOINT, phases)


@wp.kernel
def _settle_kernel(
    mask: wp.array(dtype=wp.int32),
    elements: wp.array2d(dtype=wp.float64),
    phases: Phases,  # out
    counts: Counts,
    prescribed: Prescribed,
    balance: Balance,  # out
    flags: Flags,  # out
    r: Rules,
):
    """After the joints were looked at."""
    env = wp.tid()
    if phases.active[env] != 0 and mask[env] != 0:
        weigh(env, elements, balance, r)
        settle(env, phases, prescribed, balance, flags, r)
    go_on(env, phases, counts, flags, r)


@wp.kernel
def _judge_friction_kernel(
    elements: wp.array2d(dtype=wp.float64),
    phases: Phases,  # out
    counts: Counts,  # out
    balance: Balance,  # out
    flags: Flags,  # out
    r: Rules,
):
    """Only the residual with the friction that was frozen anew counts as converged.

    Freezing is a fixed-point iteration. Where it alternates instead of shrinking (a node leaning on
    two faces in turn) the steps between are damped until it shrinks again.
    """
    env = wp.tid()
    if phases.phase[env] != FREEZING:
        return
    leave(env, phases)
    one = wp.float64(1.0)
    weigh(env, elements, balance, r)
    excess = balance.excess[env]
    damping = balance.damping[env]
    if excess > (one - wp.float64(0.1) * damping) * balance.lag_change[env]:
        balance.damping[env] = wp.max(wp.float64(0.5) * damping, wp.float64(0.05))
    else:
        balance.damping[env] = wp.min(wp.float64(1.5) * damping, one)
    balance.lag_change[env] = excess
    balance.last_residual[env] = wp.float64(wp.inf)
    counts.lags[env] += 1
    if excess <= one:
        stop(env, _CONVERGED, phases)
    elif counts.lags[env] >= r.max_lags:
        stop(env, _FRICTION, phases)
    go_on(env, phases, counts, flags, r)


def measure_and_judge(run: StepLaunches, mask: wp.array, take_trial: bool = False) -> None:
    """Forces and residual of the environments of ``mask``; those that are through stop.
    ``take_trial``: where the line search has led."""
    s, p = run.s, run.p
    if not take_trial:
        _bound_rounding(run)
    evaluate_gradient(run, mask, take_trial)
    elements = _element_rounding(run)
    run.decide(
        _judge_kernel,
        mask,
        int(s.joints is None),
        elements,
        p.phases,
        p.counts,
        p.prescribed,
        p.balance,
        p.flags,
        run.rules,
    )
    if s.joints is not None:
        wp.capture_if(p.flags.closing, on_true=lambda: _close_joints(run))
        run.decide(
            _settle_kernel,
            mask,
            elements,
            p.phases,
            p.counts,
            p.prescribed,
            p.balance,
            p.flags,
            run.rules,
        )
    if s.friction is not None:
        wp.capture_if(p.flags.freezing, on_true=lambda: _refreeze_friction(run))


def _stiff(run: StepLaunches) -> list[ElementSum]:
    """Elements of whose forces rounding may make more than the tolerance."""
    parts = (*run.s.elastic, *run.s.viscosity)
    return [part for part in parts if part.rounds_above(run.rules.absolute_tolerance)]


def _element_rounding(run: StepLaunches) -> wp.array | None:
    """What ``_bound_rounding`` found."""
    stiff = _stiff(run)
    return stiff[0].body_rounding_n if stiff else None


def _bound_rounding(run: StepLaunches) -> None:
    """What rounding makes of the forces of elements at the start of a step."""
    stiff = _stiff(run)
    for part in stiff:
        if part is stiff[0]:
            zero_rows(run.p.phases.fresh, part.body_rounding_n)
        part.add_force_rounding(run.p.phases.fresh, run.state.positions, stiff[0].body_rounding_n)


def evaluate_gradient(run: StepLaunches, mask: wp.array, take_trial: bool = False) -> None:
    """Gradient, residual, contact force and smallest gap in the environments of ``mask``.

    Their collisions are those of the positions: of the start or of the trial that is taken.
    """
    s, state, x = run.s, run.state, run.state.positions
    friction_gradient = s.friction_gradient if s.friction is not None else None
    wp.launch(
        _begin_gradient_kernel,
        dim=(run.model.env_count, max(x.shape[1], state.poses.shape[1])),
        inputs=[mask, int(take_trial), s.trial, s.trial_poses, x, state.poses]
        + [s.gradient, s.contact_gradient, friction_gradient, run.p.balance],
        device=run.model.device,
    )
    if s.joints is not None:
        s.joints.set_frames(state.poses)

    elements = [*s.elastic, *s.viscosity]

    def of_elements() -> None:
        for part in elements:
            part.write_forces(mask, x)

    def of_others() -> None:
        for term in (s.inertia, s.affine, s.joints, s.load):
            if term is not None:
                term.add_gradient(mask, x, s.gradient)

    def of_contact() -> None:
        s.contact.add_gradient(mask, x, s.contact_gradient, run.p.balance.min_distance)

    run.together([of_elements, of_others, of_contact, lambda: _add_friction(run, mask)])
    for part in elements:
        part.gather_forces(mask, s.gradient)
    _measure_residual(run, mask)


def _add_friction(run: StepLaunches, mask: wp.array) -> None:
    s = run.s
    if s.friction is not None:
        s.friction.add_gradient(mask, run.motion(), s.friction_gradient)


def evaluate_forces(run: StepLaunches, mask: wp.array) -> None:
    """Contact and friction forces alone, from collisions and friction as they are."""
    s, x = run.s, run.state.positions
    zero_rows(mask, s.contact_gradient)
    zero_rows(mask, s.friction_gradient)
    s.contact.add_gradient(mask, x, s.contact_gradient, run.p.balance.min_distance)
    _add_friction(run, mask)


def _measure_residual(run: StepLaunches, mask: wp.array) -> None:
    s, p = run.s, run.p
    gradients = [s.gradient, s.contact_gradient, s.friction_gradient]
    reduce_gradient(run.model, mask, gradients, s.reduced)
    sums = [p.balance.body_residuals, p.balance.body_forces]
    force_sums(mask, s.reduced, s.contact_gradient, s.body_rows, s.body_nodes, *sums)


def _close_joints(run: StepLaunches) -> None:
    """Where Newton has converged, correct the joint forces until the joints are closed."""
    s, p = run.s, run.p
    assert s.joints is not None
    s.joints.update_multipliers(p.phases.inner, run.state.positions)
    run.decide(
        _judge_joints_kernel, s.joints.violations, p.phases, p.counts, p.balance, p.flags, run.rules
    )
    wp.capture_if(p.flags.reopened, on_true=lambda: evaluate_gradient(run, p.phases.inner))


def _refreeze_friction(run: StepLaunches) -> None:
    """Freeze friction anew in the chosen environments, and judge them by what it is then."""
    s, p = run.s, run.p
    assert s.friction is not None
    lag, x = s.friction.lag, run.state.positions
    gradient = s.friction_gradient
    run.together(
        [lambda: lag(p.phases.inner, x, s.origin), lambda: zero_rows(p.phases.inner, gradient)]
    )
    _add_friction(run, p.phases.inner)
    _measure_residual(run, p.phases.inner)
    run.decide(
        _judge_friction_kernel,
        _element_rounding(run),
        p.phases,
        p.counts,
        p.balance,
        p.flags,
        run.rules,
    )
