# SPDX-License-Identifier: Apache-2.0
"""Forces of all terms, their residual, and what it is worth against the tolerance."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.sums import force_sums
from taccel_lab.ipc.motion.unknowns import reduce_gradient
from taccel_lab.ipc.potentials.elements.data import ElementSum
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.env_rows import zero_rows
from taccel_lab.model.launches import launch
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.step_launches import StepLaunches

wp.set_module_options({"enable_backward": False})


@wp.func
def weigh(env: int, elements: wp.array2d(dtype=wp.float64), p: Progress):
    """Find the largest force residual of a body, the largest one over what is allowed that body (at
    most 1 where all have converged), and the contact force of the environment.

    Residual and contact force are sums of magnitudes both, over the same body: the resultant on it
    is in doubt by no more than the part of its contact force that the tolerance says, however large
    the forces on other bodies are, and however fine the mesh is. What rounding alone makes of the
    residual is allowed: ``elements`` says how much of it comes from those of each body [N],
    [env_count, body_count], where they are stiff.
    """
    total = wp.float64(0.0)
    for body in range(p.balance.body_forces.shape[1]):
        total += p.balance.body_forces[env, body]
    # Action and reaction: half of the sum over both sides of all contacts.
    total = wp.float64(0.5) * total
    shared = p.rules.affine_rounding + p.balance.rounding[env]
    residual = wp.float64(0.0)
    excess = wp.float64(0.0)
    for body in range(p.balance.body_forces.shape[1]):
        found = p.balance.body_residuals[env, body]
        force = p.balance.body_forces[env, body]
        rounding = wp.float64(shared)
        if elements:
            rounding += elements[env, body]
        for gel in range(p.balance.carriers.shape[0]):
            # What presses on a gel presses on the body that carries it.
            if p.balance.carriers[gel] == body:
                force += p.balance.body_forces[env, gel]
                if elements:
                    rounding += elements[env, gel]
        force = wp.min(force, total)
        allowed = wp.max(p.rules.absolute_tolerance, p.rules.relative_tolerance * force)
        ratio = found / wp.max(allowed, rounding)
        # What is not a number is worse than anything, and stays.
        if not (found <= residual) and not wp.isnan(residual):
            residual = found
        if not (ratio <= excess) and not wp.isnan(excess):
            excess = ratio
    p.balance.contact_force[env] = total
    p.balance.residual[env] = residual
    p.balance.excess[env] = excess


@wp.kernel
def _begin_gradient_kernel(
    mask: Envs,
    take_trial: int,
    trial: wp.array2d(dtype=wp.vec3d),
    trial_poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
    gradient: wp.array2d(dtype=wp.vec3d),
    contact_gradient: wp.array2d(dtype=wp.vec3d),
    friction_gradient: wp.array2d(dtype=wp.vec3d),
    p: Progress,
):
    """Nothing is added up yet; positions and poses become those of the trial, or stay."""
    place, i = wp.tid()
    env = env_at(place, mask)
    if env < 0:
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
        p.balance.min_distance[env] = wp.float64(wp.inf)


def _stiff(run: StepLaunches) -> list[ElementSum]:
    """Elements of whose forces rounding may make more than the tolerance."""
    return [part for part in run.s.elements if part.rounds_above(run.p.rules.absolute_tolerance)]


def element_rounding(run: StepLaunches) -> wp.array | None:
    """What ``bound_rounding`` found."""
    stiff = _stiff(run)
    return stiff[0].body_rounding_n if stiff else None


def bound_rounding(run: StepLaunches) -> None:
    """What rounding makes of the forces of elements at the start of a step."""
    stiff = _stiff(run)
    for part in stiff:
        if part is stiff[0]:
            zero_rows(run.p.phases.fresh, part.body_rounding_n)
        part.add_force_rounding(run.p.phases.fresh, run.state.positions, stiff[0].body_rounding_n)


def evaluate_gradient(run: StepLaunches, mask: EnvMask, take_trial: bool = False) -> None:
    """Gradient, residual, contact force and smallest gap in the environments of ``mask``.

    Their collisions are those of the positions: of the start or of the trial that is taken.
    """
    s, state, x = run.s, run.state, run.state.positions
    friction_gradient = s.friction_gradient if s.friction is not None else None
    inputs = [mask, int(take_trial), s.trial, s.trial_poses, x, state.poses, s.gradient]
    inputs += [s.contact_gradient, friction_gradient, run.p.struct]
    most = max(x.shape[1], state.poses.shape[1])
    launch(_begin_gradient_kernel, (run.model.env_count, most), *inputs)
    if s.joints is not None:
        s.joints.set_frames(state.poses)

    def of_elements() -> None:
        for part in s.elements:
            part.write_forces(mask, x)

    def of_others() -> None:
        for term in (s.inertia, s.affine, s.joints, s.load):
            if term is not None:
                term.add_gradient(mask, x, s.gradient)

    def of_contact() -> None:
        s.contact.add_gradient(mask, x, s.contact_gradient, run.p.balance.min_distance)

    run.together([of_elements, of_others, of_contact, lambda: add_friction(run, mask)])
    for part in s.elements:
        part.gather_forces(mask, s.gradient)
    measure_residual(run, mask)


def add_friction(run: StepLaunches, mask: EnvMask) -> None:
    s = run.s
    if s.friction is not None:
        s.friction.add_gradient(mask, run.motion(), s.friction_gradient)


def evaluate_forces(run: StepLaunches, mask: EnvMask) -> None:
    """Contact and friction forces alone, from collisions and friction as they are."""
    s, x = run.s, run.state.positions
    zero_rows(mask, s.contact_gradient)
    zero_rows(mask, s.friction_gradient)
    s.contact.add_gradient(mask, x, s.contact_gradient, run.p.balance.min_distance)
    add_friction(run, mask)


def measure_residual(run: StepLaunches, mask: EnvMask) -> None:
    s, p = run.s, run.p
    gradients = [s.gradient, s.contact_gradient, s.friction_gradient]
    reduce_gradient(run.model, mask, gradients, s.reduced)
    sums = [p.balance.body_residuals, p.balance.body_forces]
    force_sums(mask, s.reduced, s.contact_gradient, s.body_rows, s.body_nodes, *sums)
