# SPDX-License-Identifier: Apache-2.0
"""Start and end of a step: set up, commit or roll back."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.motion.unknowns import measure_velocities
from taccel_lab.ipc.potentials.elements.inversion import find_inversions
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.env_rows import zero_rows
from taccel_lab.model.kinematics import chord_error, turn_between
from taccel_lab.solvers.env_phase import STEPPING, stop
from taccel_lab.solvers.env_progress import EnvProgress, Rules, lower_flags
from taccel_lab.solvers.report import EnvStatus
from taccel_lab.solvers.step_launches import StepLaunches

wp.set_module_options({"enable_backward": False})

_RUNNING = wp.constant(int(EnvStatus.RUNNING))
_CONVERGED = wp.constant(int(EnvStatus.CONVERGED))
_NOT_A_NUMBER = wp.constant(int(EnvStatus.NOT_A_NUMBER))
_INVERSION = wp.constant(int(EnvStatus.INVERSION))
_IMPACT = wp.constant(int(EnvStatus.IMPACT))
_SKIPPED = wp.constant(int(EnvStatus.SKIPPED))


@wp.kernel
def _begin_step_kernel(
    poses: wp.array2d(dtype=wp.transformd),
    end_poses: wp.array2d(dtype=wp.transformd),
    start_poses: wp.array2d(dtype=wp.transformd),
    origin_poses: wp.array2d(dtype=wp.transformd),
    p: EnvProgress,
    r: Rules,
):
    """Nothing is done yet; how far frames go and turn. What is underway goes on."""
    env = wp.tid()
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    if env == 0:
        p.rounds[0] = 0
        lower_flags(p)
    p.fresh[env] = 0
    if p.underway[env] != 0:
        return
    p.status[env] = _SKIPPED
    p.phase[env] = 0
    p.fresh[env] = p.who[env]
    p.underway[env] = p.who[env]
    p.active[env] = p.who[env]
    p.inner[env] = 0
    p.flying[env] = 0
    p.turning[env] = 0
    p.newton[env] = 0
    p.cg[env] = 0
    p.lags[env] = 0
    p.searches[env] = 0
    p.ccd_passes[env] = 0
    p.starts_tried[env] = 0
    p.starts_taken[env] = 0
    p.joint_rounds[env] = 0
    p.cuts[env] = 0
    p.residual[env] = wp.float64(wp.inf)
    p.excess[env] = wp.float64(wp.inf)
    p.contact_force[env] = zero
    p.min_distance[env] = wp.float64(wp.inf)
    p.violation[env] = zero
    p.smallest_step[env] = one
    p.progress[env] = one
    p.goal[env] = one
    p.stride[env] = one
    p.alpha[env] = one
    p.bend[env] = zero
    p.lag_change[env] = wp.float64(wp.inf)
    p.damping[env] = one
    p.margin[env] = r.dhat
    p.before[env] = zero
    p.projected[env] = 0
    p.boost[env] = one
    p.sharpness[env] = one
    p.last_residual[env] = wp.float64(wp.inf)
    if p.who[env] == 0:
        return
    p.status[env] = _RUNNING
    p.phase[env] = STEPPING
    widest = zero
    for body in range(poses.shape[1]):
        start = poses[env, body]
        end = end_poses[env, body]
        start_poses[env, body] = start
        if p.again[env] == 0:
            origin_poses[env, body] = start
        for k in range(7):
            if start[k] != end[k]:
                p.progress[env] = zero
        turn = turn_between(wp.transform_get_rotation(start), wp.transform_get_rotation(end))
        p.turns[env, body] = turn
        if turn > wp.float64(1.0e-9):
            p.turning[env] = 1
        widest = wp.max(widest, chord_error(p.radii[env, body], turn))
    if p.turning[env] != 0:
        p.margin[env] = r.dhat + widest


@wp.kernel
def _begin_nodes_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    velocities: wp.array2d(dtype=wp.vec3d),
    previous: wp.array2d(dtype=wp.vec3d),
    origin: wp.array2d(dtype=wp.vec3d),
    p: EnvProgress,
):
    """Keep where the nodes are, all of them: a number that is not finite is noted in the status."""
    env, node = wp.tid()
    if p.fresh[env] == 0:
        return
    x = positions[env, node]
    v = velocities[env, node]
    previous[env, node] = x
    if p.again[env] == 0:
        origin[env, node] = x
    if not wp.isfinite(x) or not wp.isfinite(v):
        p.status[env] = _NOT_A_NUMBER


@wp.kernel
def _stop_unfit_kernel(p: EnvProgress):
    """Stop what cannot step; an infinite elastic energy (``before``) tells an inverted element."""
    env = wp.tid()
    if p.fresh[env] == 0:
        return
    if p.status[env] == _NOT_A_NUMBER:
        stop(env, _NOT_A_NUMBER, p)
    elif wp.isinf(p.before[env]):
        stop(env, _INVERSION, p)


@wp.kernel
def _close_kernel(p: EnvProgress):
    """Tell ``done`` from ``failed``.

    What has converged with an element turned inside out by this step is no result, nor is a step of
    BDF2 that met an impact.
    """
    env = wp.tid()
    p.done[env] = 0
    p.failed[env] = 0
    if p.underway[env] != 0 and p.status[env] != _RUNNING:
        p.underway[env] = 0
        if p.status[env] == _CONVERGED and p.inverted_after[env] > p.inverted_before[env]:
            p.status[env] = _INVERSION
        if p.status[env] == _CONVERGED and p.refused[env] != 0:
            p.status[env] = _IMPACT
        if p.status[env] == _CONVERGED:
            p.done[env] = 1
        else:
            p.failed[env] = 1


def begin_step(run: StepLaunches) -> None:
    """Where everything is at the start; environments that cannot step stop."""
    s, state, p = run.s, run.state, run.p
    s.rows.read(p.reads)
    poses = [state.poses, s.end_poses, s.start_poses, s.origin_poses]
    run.decide(_begin_step_kernel, *poses, p, run.rules)
    wp.launch(
        _begin_nodes_kernel,
        dim=state.positions.shape,
        inputs=[state.positions, state.velocities, s.previous, s.origin, p],
        device=run.model.device,
    )
    _begin_potentials(run)
    for part in s.elastic:
        part.add_energy(p.fresh, state.positions, p.before)
    run.decide(_stop_unfit_kernel, p)
    if s.invertible:
        zero_rows(p.fresh, p.inverted_before)
        find_inversions(s.invertible, p.fresh, state.positions, p.inverted_before)


def _begin_potentials(run: StepLaunches) -> None:
    s, state, fresh = run.s, run.state, run.p.fresh
    x = state.positions
    if s.inertia is not None:
        s.inertia.begin_step(x, state.velocities, s.dts, state.history, fresh)
    for part in s.viscosity:
        part.begin_step(x, s.dts, fresh)
    if s.joints is not None:
        s.joints.begin_step(x, state.poses, s.dts, fresh)
        wp.copy(run.p.rounding, s.joints.rounding_n)
        wp.copy(run.p.joint_energy_rounding, s.joints.rounding_j)
    if s.load is not None:
        forces, wrenches = state.loads(run.model)
        s.load.begin_step(x, forces, wrenches, fresh)
    if s.friction is not None:
        s.friction.begin_step(fresh, s.dts)


def end_step(run: StepLaunches) -> None:
    """Roll back what failed; velocities and joints of what converged, which the user's state
    gets."""
    s, state, p = run.s, run.state, run.p
    if s.silent:
        p.inverted_after.zero_()
        find_inversions(s.silent, p.underway, state.positions, p.inverted_after)
    if s.inertia is not None and state.history is not None:
        least = s.config.absolute_tolerance_n
        s.inertia.find_jumps(p.body_forces, state.history, least, p.refused)
    run.decide(_close_kernel, p)
    run.commit(p.failed, s.previous, s.start_poses)
    embed_vertices(run.model, state.positions)
    if s.joints is not None:
        s.joints.end_step(p.done, state.positions)
        s.joints.restore(p.failed)
    if s.inertia is not None:
        s.inertia.end_step(
            p.done, s.previous, state.positions, state.velocities, state.history, p.body_forces
        )
    else:
        measure_velocities(p.done, s.origin, state.positions, s.dts, state.velocities)
    s.rows.write(p.done, p.writes)
