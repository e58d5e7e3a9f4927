# SPDX-License-Identifier: Apache-2.0
"""Start and end of a step: set up, commit or roll back."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.motion.unknowns import measure_velocities
from taccel_lab.ipc.potentials.elements.inversion import find_inversions
from taccel_lab.ipc.potentials.friction import ToolWays
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.env_rows import zero_rows
from taccel_lab.model.kinematics import chord_error, turn_between
from taccel_lab.model.launches import launch
from taccel_lab.solvers.env_phase import STEPPING, forget_gain, stop
from taccel_lab.solvers.env_progress import Progress, lower_flags
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False})

_RUNNING = wp.constant(int(EnvStatus.RUNNING))
_CONVERGED = wp.constant(int(EnvStatus.CONVERGED))
_NOT_A_NUMBER = wp.constant(int(EnvStatus.NOT_A_NUMBER))
_INVERSION = wp.constant(int(EnvStatus.INVERSION))
_IMPACT = wp.constant(int(EnvStatus.IMPACT))
_SKIPPED = wp.constant(int(EnvStatus.SKIPPED))
_OVERLAP = wp.constant(int(EnvStatus.OVERLAP))


@wp.func
def _overlaps(env: int, count: int, address: wp.uint64) -> bool:
    """Whether bodies overlap in an environment, by the mask at an address; at 0 is none."""
    if address == wp.uint64(0):
        return False
    mask = wp.array(ptr=address, shape=(count,), dtype=wp.int32)
    return mask[env] != 0


@wp.kernel
def _begin_step_kernel(
    overlapping: wp.array(dtype=wp.uint64),
    asked_poses: wp.array2d(dtype=wp.transformd),
    poses: wp.array2d(dtype=wp.transformd),
    end_poses: wp.array2d(dtype=wp.transformd),
    start_poses: wp.array2d(dtype=wp.transformd),
    origin_poses: wp.array2d(dtype=wp.transformd),
    p: Progress,
):
    """Nothing is done yet; how far frames go and turn. What is underway goes on; where bodies
    overlap nothing begins."""
    env = wp.tid()
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    if env == 0:
        p.flags.rounds[0] = 0
        lower_flags(p)
    p.phases.fresh[env] = 0
    if p.roster.underway[env] != 0:
        return
    p.phases.status[env] = _SKIPPED
    begins = p.roster.who[env]
    if begins != 0 and _overlaps(env, poses.shape[0], overlapping[0]):
        p.phases.status[env] = _OVERLAP
        begins = 0
    p.phases.phase[env] = 0
    p.phases.fresh[env] = begins
    p.roster.underway[env] = begins
    p.phases.active[env] = begins
    p.phases.stepping[env] = begins
    p.phases.searching[env] = 0
    p.phases.inner[env] = 0
    p.phases.flying[env] = 0
    p.prescribed.turning[env] = 0
    p.counts.newton[env] = 0
    p.counts.cg[env] = 0
    p.counts.lags[env] = 0
    p.counts.searches[env] = 0
    p.counts.ccd_passes[env] = 0
    p.counts.starts_tried[env] = 0
    p.counts.starts_taken[env] = 0
    p.counts.joint_rounds[env] = 0
    p.search.cuts[env] = 0
    p.search.strays[env] = 0
    p.balance.residual[env] = wp.float64(wp.inf)
    p.balance.excess[env] = wp.float64(wp.inf)
    p.balance.contact_force[env] = zero
    p.balance.min_distance[env] = wp.float64(wp.inf)
    p.balance.violation[env] = zero
    p.search.smallest_step[env] = one
    p.prescribed.progress[env] = one
    p.prescribed.goal[env] = one
    p.prescribed.stride[env] = one
    p.search.alpha[env] = one
    p.clearance.bend[env] = zero
    p.balance.lag_change[env] = wp.float64(wp.inf)
    p.balance.damping[env] = one
    p.clearance.margin[env] = p.rules.dhat
    p.search.before[env] = zero
    p.search.after[env] = wp.float64(wp.inf)
    forget_gain(env, p)
    p.gain.counted[env] = zero
    p.curvature.projected[env] = 0
    p.curvature.sharpness[env] = one
    p.balance.last_residual[env] = wp.float64(wp.inf)
    if begins == 0:
        return
    p.phases.status[env] = _RUNNING
    p.phases.phase[env] = STEPPING
    widest = zero
    for body in range(poses.shape[1]):
        start = poses[env, body]
        end = end_poses[env, body]
        if p.roster.reads[env] != 0:
            end = asked_poses[env, body]
            end_poses[env, body] = end
        start_poses[env, body] = start
        if p.roster.again[env] == 0:
            origin_poses[env, body] = start
        for k in range(7):
            if start[k] != end[k]:
                p.prescribed.progress[env] = zero
            if not wp.isfinite(end[k]):
                p.phases.status[env] = _NOT_A_NUMBER
        turn = turn_between(wp.transform_get_rotation(start), wp.transform_get_rotation(end))
        p.prescribed.turns[env, body] = turn
        if turn > wp.float64(1.0e-9):
            p.prescribed.turning[env] = 1
        widest = wp.max(widest, chord_error(p.prescribed.radii[env, body], turn))
    if p.prescribed.turning[env] != 0:
        p.clearance.margin[env] = p.rules.dhat + widest


@wp.kernel
def _begin_nodes_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    velocities: wp.array2d(dtype=wp.vec3d),
    previous: wp.array2d(dtype=wp.vec3d),
    origin: wp.array2d(dtype=wp.vec3d),
    p: Progress,
):
    """Keep where the nodes are, all of them: a number that is not finite is noted in the status."""
    env, node = wp.tid()
    if p.phases.fresh[env] == 0:
        return
    x = positions[env, node]
    v = velocities[env, node]
    previous[env, node] = x
    if p.roster.again[env] == 0:
        origin[env, node] = x
    if not wp.isfinite(x) or not wp.isfinite(v):
        p.phases.status[env] = _NOT_A_NUMBER


@wp.kernel
def _stop_unfit_kernel(p: Progress):
    """Stop what cannot step; an infinite elastic energy (``before``) tells an inverted element."""
    env = wp.tid()
    if p.phases.fresh[env] == 0:
        return
    if p.phases.status[env] == _NOT_A_NUMBER:
        stop(env, _NOT_A_NUMBER, p)
    elif wp.isinf(p.search.before[env]):
        stop(env, _INVERSION, p)


@wp.kernel
def _close_kernel(p: Progress):
    """Tell ``done`` from ``failed``.

    What has converged with an element turned inside out by this step is no result, nor is a step of
    BDF2 that met an impact.
    """
    env = wp.tid()
    p.roster.done[env] = 0
    p.roster.failed[env] = 0
    if p.roster.underway[env] != 0 and p.phases.status[env] != _RUNNING:
        p.roster.underway[env] = 0
        if (
            p.phases.status[env] == _CONVERGED
            and p.roster.inverted_after[env] > p.roster.inverted_before[env]
        ):
            p.phases.status[env] = _INVERSION
        if p.phases.status[env] == _CONVERGED and p.roster.refused[env] != 0:
            p.phases.status[env] = _IMPACT
        if p.phases.status[env] == _CONVERGED:
            p.roster.done[env] = 1
        else:
            p.roster.failed[env] = 1


def begin_step(run: StepLaunches) -> None:
    """Where everything is at the start; environments that cannot step stop."""
    s, state, p = run.s, run.state, run.p
    s.rows.read(p.roster.reads)
    poses = [s.orders.targets, state.poses, s.end_poses, s.start_poses, s.origin_poses]
    run.decide(_begin_step_kernel, s.rows.overlapping, *poses)
    inputs = [state.positions, state.velocities, s.previous, s.origin, p.struct]
    launch(_begin_nodes_kernel, state.positions.shape, *inputs)
    _begin_potentials(run)
    for part in s.elastic:
        part.add_energy(p.phases.fresh, state.positions, p.search.before)
    run.decide(_stop_unfit_kernel)
    if s.invertible:
        zero_rows(p.phases.fresh, p.roster.inverted_before)
        find_inversions(s.invertible, p.phases.fresh, state.positions, p.roster.inverted_before)


def _begin_potentials(run: StepLaunches) -> None:
    s, state, fresh = run.s, run.state, run.p.phases.fresh
    x = state.positions
    if s.inertia is not None:
        s.inertia.begin_step(x, state.velocities, s.dts, state.history, fresh)
    for part in s.maxwell:
        part.begin_step(x, state.viscous_inverses, s.dts, fresh, run.p.roster.again)
    if s.joints is not None:
        s.joints.begin_step(x, state.poses, s.dts, fresh)
        wp.copy(run.p.balance.rounding, s.joints.rounding_n)
        wp.copy(run.p.search.joint_energy_rounding, s.joints.rounding_j)
    if s.load is not None:
        forces, wrenches = state.loads(run.model)
        s.load.begin_step(x, forces, wrenches, fresh)
    if s.friction is not None:
        tools = ToolWays()
        tools.starts, tools.ends = s.origin_poses, s.end_poses
        tools.radii = run.p.prescribed.radii
        others = s.inertia is not None or s.affine is not None or s.load is not None
        tools_alone = bool(run.model.kinematic) and not others
        tools.share = s.config.friction_step_share if tools_alone else 0.0
        s.friction.begin_step(fresh, s.dts, s.whole_dts, tools)


def end_step(run: StepLaunches) -> None:
    """Roll back what failed; velocities and joints of what converged, which the user's state
    gets."""
    s, state, p = run.s, run.state, run.p
    if s.invertible:
        p.roster.inverted_after.zero_()
        find_inversions(s.invertible, p.roster.underway, state.positions, p.roster.inverted_after)
    if s.inertia is not None and state.history is not None:
        least = s.config.absolute_tolerance_n
        s.inertia.find_jumps(p.balance.body_forces, state.history, least, p.roster.refused)
    run.decide(_close_kernel)
    run.commit(p.roster.failed, s.previous, s.start_poses)
    embed_vertices(run.model, state.positions)
    if s.joints is not None:
        s.joints.end_step(p.roster.done, state.positions)
        s.joints.restore(p.roster.failed)
    if s.inertia is not None:
        s.inertia.end_step(
            p.roster.done,
            s.previous,
            state.positions,
            state.velocities,
            state.history,
            p.balance.body_forces,
        )
    else:
        measure_velocities(p.roster.done, s.origin, state.positions, s.dts, state.velocities)
    for part in s.maxwell:
        part.end_step(state.positions, state.viscous_inverses, p.roster.done)
    s.rows.write(p.roster.done, p.roster.writes)
