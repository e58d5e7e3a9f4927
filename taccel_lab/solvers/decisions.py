# SPDX-License-Identifier: Apache-2.0
"""What each environment does next, decided on the device: one thread an environment."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.capacity import ListRoom, overflows
from taccel_lab.model.kinematics import chord_error, turn_between
from taccel_lab.solvers.env_progress import EnvProgress, Rules
from taccel_lab.solvers.report import EnvStatus

wp.set_module_options({"enable_backward": False})

_RUNNING = wp.constant(int(EnvStatus.RUNNING))
_CONVERGED = wp.constant(int(EnvStatus.CONVERGED))
_NO_CONVERGENCE = wp.constant(int(EnvStatus.NO_CONVERGENCE))
_NOT_A_NUMBER = wp.constant(int(EnvStatus.NOT_A_NUMBER))
_FRICTION = wp.constant(int(EnvStatus.FRICTION))
_INVERSION = wp.constant(int(EnvStatus.INVERSION))
_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))
_JOINT = wp.constant(int(EnvStatus.JOINT))
_TOUCHING = wp.constant(int(EnvStatus.TOUCHING))
_IMPACT = wp.constant(int(EnvStatus.IMPACT))
_SKIPPED = wp.constant(int(EnvStatus.SKIPPED))


@wp.func
def stop(env: int, status: int, p: EnvProgress):
    """End the step of an environment."""
    p.status[env] = status
    p.active[env] = 0
    p.waiting[env] = 0
    p.chosen[env] = 0


@wp.func
def weigh(env: int, p: EnvProgress, r: Rules):
    """Find the largest force residual of a body, the largest one over what is allowed that body (at
    most 1 where all have converged), and the contact force of the environment.

    Residual and contact force are sums of magnitudes both, over the same body: the resultant on it
    is in doubt by no more than the part of its contact force that the tolerance says, however large
    the forces on other bodies are, and however fine the mesh is.
    """
    total = wp.float64(0.0)
    for body in range(p.body_forces.shape[1]):
        total += p.body_forces[env, body]
    # Action and reaction: half of the sum over both sides of all contacts.
    total = wp.float64(0.5) * total
    rounding = wp.max(r.absolute_tolerance, r.affine_rounding + p.rounding[env])
    residual = wp.float64(0.0)
    excess = wp.float64(0.0)
    for body in range(p.body_forces.shape[1]):
        found = p.body_residuals[env, body]
        force = wp.min(p.body_forces[env, body], total)
        ratio = found / wp.max(rounding, r.relative_tolerance * force)
        # What is not a number is worse than anything, and stays.
        if not (found <= residual) and not wp.isnan(residual):
            residual = found
        if not (ratio <= excess) and not wp.isnan(excess):
            excess = ratio
    p.contact_force[env] = total
    p.residual[env] = residual
    p.excess[env] = excess


# Beginning and end of a step -----------------------------------------------------------------


@wp.kernel
def begin_kernel(
    poses: wp.array2d(dtype=wp.transformd),
    end_poses: wp.array2d(dtype=wp.transformd),
    start_poses: wp.array2d(dtype=wp.transformd),
    origin_poses: wp.array2d(dtype=wp.transformd),
    p: EnvProgress,
    r: Rules,
):
    """Nothing is done yet; how far frames go and turn."""
    env = wp.tid()
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    p.status[env] = _SKIPPED
    p.active[env] = p.who[env]
    p.waiting[env] = 0
    p.chosen[env] = 0
    p.turning[env] = 0
    p.newton[env] = 0
    p.cg[env] = 0
    p.lags[env] = 0
    p.joint_rounds[env] = 0
    p.residual[env] = wp.float64(wp.inf)
    p.excess[env] = wp.float64(wp.inf)
    p.contact_force[env] = zero
    p.min_distance[env] = wp.float64(wp.inf)
    p.violation[env] = zero
    p.smallest_step[env] = one
    p.progress[env] = one
    p.goal[env] = one
    p.stride[env] = one
    p.lag_change[env] = wp.float64(wp.inf)
    p.damping[env] = one
    p.margin[env] = r.dhat
    p.before[env] = zero
    p.boost[env] = one
    p.sharpness[env] = one
    p.last_excess[env] = wp.float64(wp.inf)
    if p.who[env] == 0:
        return
    p.status[env] = _RUNNING
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
            p.any_turning[0] = 1
        widest = wp.max(widest, chord_error(p.radii[env, body], turn))
    if p.turning[env] != 0:
        p.margin[env] = r.dhat + widest


@wp.kernel
def begin_nodes_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    velocities: wp.array2d(dtype=wp.vec3d),
    previous: wp.array2d(dtype=wp.vec3d),
    origin: wp.array2d(dtype=wp.vec3d),
    p: EnvProgress,
):
    """Keep where the nodes are; an environment with a number that is not finite stops."""
    env, node = wp.tid()
    if p.who[env] == 0:
        return
    x = positions[env, node]
    v = velocities[env, node]
    previous[env, node] = x
    if p.again[env] == 0:
        origin[env, node] = x
    if not wp.isfinite(x) or not wp.isfinite(v):
        stop(env, _NOT_A_NUMBER, p)


@wp.kernel
def stop_inverted_kernel(p: EnvProgress):
    """An elastic energy (in ``before``) that is infinite tells an inverted element."""
    env = wp.tid()
    if p.active[env] != 0 and wp.isinf(p.before[env]):
        stop(env, _INVERSION, p)


@wp.kernel
def stop_overflowed_kernel(mask: wp.array(dtype=wp.int32), room: ListRoom, p: EnvProgress):
    """Stop environments of ``mask`` whose list was too short."""
    env = wp.tid()
    if mask[env] != 0 and overflows(env, room):
        stop(env, _CONTACT_OVERFLOW, p)


@wp.kernel
def close_kernel(p: EnvProgress):
    """``active`` becomes those that have converged, ``chosen`` those that are to be rolled back.

    What has converged with an element turned inside out by this step is no result, nor is a step of
    BDF2 that met an impact.
    """
    env = wp.tid()
    p.active[env] = 0
    p.chosen[env] = 0
    if p.who[env] != 0:
        if p.status[env] == _CONVERGED and p.inverted_after[env] > p.inverted_before[env]:
            p.status[env] = _INVERSION
        if p.status[env] == _CONVERGED and p.refused[env] != 0:
            p.status[env] = _IMPACT
        if p.status[env] == _CONVERGED:
            p.active[env] = 1
        else:
            p.chosen[env] = 1


# Has it converged? ---------------------------------------------------------------------------


@wp.kernel
def begin_gradient_kernel(
    mask: wp.array(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.vec3d),
    contact_gradient: wp.array2d(dtype=wp.vec3d),
    p: EnvProgress,
):
    env, node = wp.tid()
    if mask[env] == 0:
        return
    gradient[env, node] = wp.vec3d()
    contact_gradient[env, node] = wp.vec3d()
    if node == 0:
        p.min_distance[env] = wp.float64(wp.inf)


@wp.func
def go_on(env: int, p: EnvProgress, r: Rules):
    """Stop where the iterations are used up; ``running`` says whether anything goes on."""
    if p.active[env] != 0:
        if p.newton[env] >= r.max_newton:
            stop(env, _NO_CONVERGENCE, p)
        else:
            p.running[0] = 1


@wp.func
def settle(env: int, p: EnvProgress, r: Rules):
    """Stop what has converged; with friction, choose where it is frozen anew.

    ``chosen``: environments whose joints are open. While freezing anew still changes forces,
    solving in between to the last digit is wasted: a tenth of the last change is enough, and one
    step when damped. In a first contact friction waits for a residual of a tenth of the contact
    force: frames on their way squeeze what lies ahead, and friction frozen then holds it there.
    """
    settled = p.active[env] != 0 and p.progress[env] >= wp.float64(1.0) and p.chosen[env] == 0
    p.chosen[env] = 0
    if settled:
        enough = wp.float64(1.0)
        if r.has_friction == 0:
            if p.excess[env] <= enough:
                stop(env, _CONVERGED, p)
        else:
            change = p.lag_change[env]
            if p.untouched[env] != 0:
                change = wp.min(change, enough / r.relative_tolerance)
            enough = wp.max(enough, wp.float64(0.1) * change)
            if p.excess[env] <= enough or p.damping[env] < wp.float64(1.0):
                p.chosen[env] = 1
                p.freezing[0] = 1
    if r.has_friction == 0:
        go_on(env, p, r)


@wp.kernel
def judge_kernel(p: EnvProgress, r: Rules):
    """Stop what cannot go on; with joints, choose the environments whose are to be looked at.

    Without joints and without friction, all that follows is decided at once.
    """
    env = wp.tid()
    p.chosen[env] = 0
    if p.active[env] == 0:
        return
    weigh(env, p, r)
    if p.newton[env] == 0:
        p.untouched[env] = int(p.contact_force[env] == wp.float64(0.0))
    if not (p.min_distance[env] > wp.float64(0.0)):
        stop(env, _TOUCHING, p)
    elif not wp.isfinite(p.residual[env]):
        stop(env, _NOT_A_NUMBER, p)
    elif r.has_joints != 0:
        if p.progress[env] >= wp.float64(1.0) and p.excess[env] <= wp.float64(1.0):
            p.chosen[env] = 1
            p.closing[0] = 1
    else:
        settle(env, p, r)


@wp.kernel
def judge_joints_kernel(violations: wp.array(dtype=wp.float64), p: EnvProgress, r: Rules):
    """``chosen``: environments in which Newton has converged; then those with open joints."""
    env = wp.tid()
    if p.chosen[env] == 0:
        return
    p.violation[env] = violations[env]
    if not (violations[env] > r.joint_tolerance):
        p.chosen[env] = 0
        return
    p.joint_rounds[env] += 1
    p.reopened[0] = 1
    if p.joint_rounds[env] > r.max_joint_rounds:
        stop(env, _JOINT, p)


@wp.kernel
def settle_kernel(p: EnvProgress, r: Rules):
    """After the joints were looked at."""
    env = wp.tid()
    if p.active[env] != 0:
        weigh(env, p, r)
    settle(env, p, r)


@wp.kernel
def judge_friction_kernel(p: EnvProgress, r: Rules):
    """Only the residual with the friction that was frozen anew counts as converged.

    Freezing is a fixed-point iteration. Where it alternates instead of shrinking (a node leaning on
    two faces in turn) the steps between are damped until it shrinks again.
    """
    env = wp.tid()
    if p.chosen[env] == 0:
        return
    one = wp.float64(1.0)
    weigh(env, p, r)
    excess = p.excess[env]
    damping = p.damping[env]
    if excess > (one - wp.float64(0.1) * damping) * p.lag_change[env]:
        p.damping[env] = wp.max(wp.float64(0.5) * damping, wp.float64(0.05))
    else:
        p.damping[env] = wp.min(wp.float64(1.5) * damping, one)
    p.lag_change[env] = excess
    p.last_excess[env] = wp.float64(wp.inf)
    p.lags[env] += 1
    if excess <= one:
        stop(env, _CONVERGED, p)
    elif p.lags[env] >= r.max_lags:
        stop(env, _FRICTION, p)


@wp.kernel
def go_on_kernel(p: EnvProgress, r: Rules):
    """After friction was frozen anew."""
    env = wp.tid()
    go_on(env, p, r)
