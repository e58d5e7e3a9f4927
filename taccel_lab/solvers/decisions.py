# SPDX-License-Identifier: Apache-2.0
"""What each environment does next, decided on the device: one thread an environment."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.capacity import ListRoom, overflows
from taccel_lab.ipc.kinematics import chord_error, turn_between, turn_within
from taccel_lab.solvers.progress import Progress, Rules
from taccel_lab.solvers.report import EnvStatus

wp.set_module_options({"enable_backward": False})

_RUNNING = wp.constant(int(EnvStatus.RUNNING))
_CONVERGED = wp.constant(int(EnvStatus.CONVERGED))
_NO_CONVERGENCE = wp.constant(int(EnvStatus.NO_CONVERGENCE))
_LINE_SEARCH = wp.constant(int(EnvStatus.LINE_SEARCH))
_NOT_A_NUMBER = wp.constant(int(EnvStatus.NOT_A_NUMBER))
_FRICTION = wp.constant(int(EnvStatus.FRICTION))
_INVERSION = wp.constant(int(EnvStatus.INVERSION))
_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))
_JOINT = wp.constant(int(EnvStatus.JOINT))
_TOUCHING = wp.constant(int(EnvStatus.TOUCHING))
LARGEST_BOOST = 64.0
_SKIPPED = wp.constant(int(EnvStatus.SKIPPED))


@wp.func
def stop(env: int, status: int, p: Progress):
    """End the step of an environment."""
    p.status[env] = status
    p.active[env] = 0
    p.waiting[env] = 0
    p.chosen[env] = 0


@wp.func
def tolerance(env: int, p: Progress, r: Rules) -> wp.float64:
    """Force residual at which an environment has converged [N]."""
    force = wp.max(r.absolute_tolerance, r.relative_tolerance * p.contact_force[env])
    return wp.max(force, r.affine_rounding + p.rounding[env])


# Beginning and end of a step -----------------------------------------------------------------


@wp.kernel
def begin_kernel(
    poses: wp.array2d(dtype=wp.transformd),
    end_poses: wp.array2d(dtype=wp.transformd),
    start_poses: wp.array2d(dtype=wp.transformd),
    p: Progress,
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
    p.last_residual[env] = wp.float64(wp.inf)
    if p.who[env] == 0:
        return
    p.status[env] = _RUNNING
    widest = zero
    for body in range(poses.shape[1]):
        start = poses[env, body]
        end = end_poses[env, body]
        start_poses[env, body] = start
        for k in range(7):
            if start[k] != end[k]:
                p.progress[env] = zero
        turn = turn_between(wp.transform_get_rotation(start), wp.transform_get_rotation(end))
        p.turns[env, body] = turn
        if turn > wp.float64(1.0e-9):
            p.turning[env] = 1
            p.any_turning[0] = 1
        widest = wp.max(widest, chord_error(p.radii[body], turn))
    if p.turning[env] != 0:
        p.margin[env] = r.dhat + widest


@wp.kernel
def begin_nodes_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    velocities: wp.array2d(dtype=wp.vec3d),
    previous: wp.array2d(dtype=wp.vec3d),
    p: Progress,
):
    """Keep where the nodes are; an environment with a number that is not finite stops."""
    env, node = wp.tid()
    if p.who[env] == 0:
        return
    x = positions[env, node]
    v = velocities[env, node]
    previous[env, node] = x
    if not wp.isfinite(x) or not wp.isfinite(v):
        stop(env, _NOT_A_NUMBER, p)


@wp.kernel
def stop_inverted_kernel(p: Progress):
    """An elastic energy (in ``before``) that is infinite tells an inverted element."""
    env = wp.tid()
    if p.active[env] != 0 and wp.isinf(p.before[env]):
        stop(env, _INVERSION, p)


@wp.kernel
def stop_overflowed_kernel(mask: wp.array(dtype=wp.int32), room: ListRoom, p: Progress):
    """Stop environments of ``mask`` whose list was too short."""
    env = wp.tid()
    if mask[env] != 0 and overflows(env, room):
        stop(env, _CONTACT_OVERFLOW, p)


@wp.kernel
def close_kernel(p: Progress):
    """``active`` becomes those that have converged, ``chosen`` those that are to be rolled back."""
    env = wp.tid()
    p.active[env] = 0
    p.chosen[env] = 0
    if p.who[env] != 0:
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
    p: Progress,
):
    env, node = wp.tid()
    if mask[env] == 0:
        return
    gradient[env, node] = wp.vec3d()
    contact_gradient[env, node] = wp.vec3d()
    if node == 0:
        p.min_distance[env] = wp.float64(wp.inf)


@wp.func
def go_on(env: int, p: Progress, r: Rules):
    """Stop where the iterations are used up; ``running`` says whether anything goes on."""
    if p.active[env] != 0:
        if p.newton[env] >= r.max_newton:
            stop(env, _NO_CONVERGENCE, p)
        else:
            p.running[0] = 1


@wp.func
def settle(env: int, p: Progress, r: Rules):
    """Stop what has converged; with friction, choose where it is frozen anew.

    ``chosen``: environments whose joints are open. While freezing anew still changes forces,
    solving in between to the last digit is wasted: a tenth of the last change is enough, and one
    step when damped.
    """
    settled = p.active[env] != 0 and p.progress[env] >= wp.float64(1.0) and p.chosen[env] == 0
    p.chosen[env] = 0
    if settled:
        enough = tolerance(env, p, r)
        if r.has_friction == 0:
            if p.residual[env] <= enough:
                stop(env, _CONVERGED, p)
        else:
            enough = wp.max(enough, wp.float64(0.1) * p.lag_change[env])
            if p.residual[env] <= enough or p.damping[env] < wp.float64(1.0):
                p.chosen[env] = 1
                p.freezing[0] = 1
    if r.has_friction == 0:
        go_on(env, p, r)


@wp.kernel
def judge_kernel(p: Progress, r: Rules):
    """Stop what cannot go on; with joints, choose the environments whose are to be looked at.

    Without joints and without friction, all that follows is decided at once.
    """
    env = wp.tid()
    p.chosen[env] = 0
    if p.active[env] == 0:
        return
    if not (p.min_distance[env] > wp.float64(0.0)):
        stop(env, _TOUCHING, p)
    elif not wp.isfinite(p.residual[env]):
        stop(env, _NOT_A_NUMBER, p)
    elif r.has_joints != 0:
        if p.progress[env] >= wp.float64(1.0) and p.residual[env] <= tolerance(env, p, r):
            p.chosen[env] = 1
            p.closing[0] = 1
    else:
        settle(env, p, r)


@wp.kernel
def judge_joints_kernel(violations: wp.array(dtype=wp.float64), p: Progress, r: Rules):
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
def settle_kernel(p: Progress, r: Rules):
    """After the joints were looked at."""
    env = wp.tid()
    settle(env, p, r)


@wp.kernel
def judge_friction_kernel(p: Progress, r: Rules):
    """Only the residual with the friction that was frozen anew counts as converged.

    Freezing is a fixed-point iteration. Where it alternates instead of shrinking (a node leaning on
    two faces in turn) the steps between are damped until it shrinks again.
    """
    env = wp.tid()
    if p.chosen[env] == 0:
        return
    one = wp.float64(1.0)
    residual = p.residual[env]
    damping = p.damping[env]
    if residual > (one - wp.float64(0.1) * damping) * p.lag_change[env]:
        p.damping[env] = wp.max(wp.float64(0.5) * damping, wp.float64(0.05))
    else:
        p.damping[env] = wp.min(wp.float64(1.5) * damping, one)
    p.lag_change[env] = residual
    p.last_residual[env] = wp.float64(wp.inf)
    p.lags[env] += 1
    if residual <= tolerance(env, p, r):
        stop(env, _CONVERGED, p)
    elif p.lags[env] >= r.max_lags:
        stop(env, _FRICTION, p)


@wp.kernel
def go_on_kernel(p: Progress, r: Rules):
    """After friction was frozen anew."""
    env = wp.tid()
    go_on(env, p, r)


# The search direction ------------------------------------------------------------------------


@wp.func
def boosted(env: int, p: Progress) -> wp.float64:
    """Twice the last multiple after a full step that hardly lowered the residual, else one.

    Near a saddle, where a gel snaps over an edge, the projected matrix is stiffer than the body:
    whole steps go on for dozens of iterations and each takes the same small part of the way.
    """
    one = wp.float64(1.0)
    if p.progress[env] < one or p.damping[env] < one:
        return one
    ratio = p.residual[env] / p.last_residual[env]
    if ratio < wp.float64(0.7) or ratio > wp.float64(2.0):
        return one
    if p.cuts[env] > 0 or p.limit[env] < one or p.last_residual[env] == wp.float64(wp.inf):
        return one
    return wp.min(wp.float64(4.0) * p.boost[env], wp.float64(LARGEST_BOOST))


@wp.kernel
def aim_kernel(p: Progress, r: Rules, linear_tolerances: wp.array(dtype=wp.float64)):
    """How far the frames try to go next, and how well the system has to be solved.

    CCD clears the chords. Over a large angle they leave the arcs far behind, and the body would
    pass what lies between; a chord that leaves its arc by more than half of the smallest gap is cut
    in any case.

    The relative tolerance of CG is what it takes to converge with this very step, at most 0.01:
    looser solves far from the solution, as in [Eisenstat and Walker 1996], cost more in Newton
    iterations than they save in CG, and at 0.1 the gel no longer follows the body.
    """
    env = wp.tid()
    if env == 0:
        p.searching[0] = 0
        p.any_curved[0] = p.any_turning[0]
    p.moving[env] = 0
    p.bend[env] = wp.float64(0.0)
    p.reach[env] = p.margin[env]
    if p.active[env] == 0:
        return
    one = wp.float64(1.0)
    progress = p.progress[env]
    goal = one
    if p.stride[env] < one:
        goal = progress + p.stride[env] * (one - progress)
    gap = wp.min(p.min_distance[env], r.dhat)
    for body in range(p.turns.shape[1]):
        share = turn_within(p.radii[body], gap) / wp.max(p.turns[env, body], wp.float64(1.0e-300))
        goal = wp.min(goal, progress + share)
    p.goal[env] = goal
    if progress < one:
        p.moving[env] = 1
    p.boost[env] = boosted(env, p)
    p.last_residual[env] = p.residual[env]
    ratio = tolerance(env, p, r) / wp.max(p.residual[env], wp.float64(1.0e-300))
    linear_tolerances[env] = wp.clamp(
        wp.float64(0.3) * ratio, wp.float64(1.0e-6), wp.float64(1.0e-2)
    )


@wp.kernel
def count_solve_kernel(
    iterations: wp.array(dtype=wp.int32),
    breakdown: wp.array(dtype=wp.int32),
    extra: ListRoom,
    p: Progress,
):
    """After a breakdown the last iterate still descends, unless there is none."""
    env = wp.tid()
    if p.active[env] == 0:
        return
    if overflows(env, extra):
        stop(env, _CONTACT_OVERFLOW, p)
        return
    p.cg[env] += iterations[env]
    p.newton[env] += 1
    if breakdown[env] != 0 and iterations[env] == 0:
        stop(env, _NOT_A_NUMBER, p)


# The line search -----------------------------------------------------------------------------


@wp.kernel
def bend_kernel(smallest: wp.float64, p: Progress):
    """Note whether steps are bent, and how far they may lead off the straight ones."""
    env = wp.tid()
    if p.active[env] != 0 and p.bend[env] > smallest:
        p.reach[env] = p.margin[env] + p.deviation[env]
        p.any_curved[0] = 1


@wp.kernel
def open_search_kernel(
    largest_turn: wp.float64, node_faces: ListRoom, edge_edges: ListRoom, p: Progress
):
    """Start from the collision-free fraction."""
    env = wp.tid()
    p.waiting[env] = 0
    if p.active[env] == 0:
        return
    if overflows(env, node_faces) or overflows(env, edge_edges):
        stop(env, _CONTACT_OVERFLOW, p)
        return
    p.cuts[env] = 0
    alpha = wp.min(p.limit[env], p.damping[env])
    alpha = wp.min(alpha, largest_turn / wp.max(p.bend[env], wp.float64(1.0e-300)))
    p.alpha[env] = alpha
    if alpha > wp.float64(0.0):
        p.waiting[env] = 1
        p.searching[0] = 1
    else:
        stop(env, _TOUCHING, p)


@wp.kernel
def begin_trial_kernel(p: Progress):
    env = wp.tid()
    if env == 0:
        p.searching[0] = 0
    if p.waiting[env] == 0:
        return
    progress = p.progress[env] + p.alpha[env] * (p.goal[env] - p.progress[env])
    if progress > wp.float64(1.0 - 1.0e-12):
        progress = wp.float64(1.0)
    p.trial_progress[env] = progress


@wp.func
def adapted_stride(stride: wp.float64, fraction: wp.float64) -> wp.float64:
    """Part of the remaining motion to ask for next, after ``fraction`` of the last was accepted.

    The gel's answer is linear in the motion asked for. Cutting the direction again and again
    instead uses up a tenth of the gap each time, until the barrier is too stiff to recover.
    """
    if fraction < wp.float64(0.1):
        return wp.max(wp.float64(0.25) * stride, wp.float64(1.0e-9))
    if fraction >= wp.float64(0.5):
        return wp.min(wp.float64(2.0) * stride, wp.float64(1.0))
    return stride


@wp.kernel
def accept_kernel(smallest_bend: wp.float64, collisions: ListRoom, p: Progress, r: Rules):
    """Accept a trial that lowers the energy, or halve its fraction.

    While frames are still on their way the energy may rise: they do work. A body that turns leaves
    the chord that CCD checked: where one does, ``limit`` is that of the path really taken.
    Sums of that many terms carry rounding of about 1e-14 of the energy, and each element's energy
    is a small difference of terms as large as its shear modulus times its volume.
    """
    env = wp.tid()
    if p.waiting[env] == 0:
        return
    if overflows(env, collisions):
        stop(env, _CONTACT_OVERFLOW, p)
        return
    one = wp.float64(1.0)
    before = p.before[env]
    after = p.after[env]
    alpha = p.alpha[env]
    rounding = p.energy_rounding[env] + p.joint_energy_rounding[env]
    rounding += wp.float64(1.0e-13) * wp.abs(before)
    descent = wp.float64(1.0e-4) * alpha * wp.min(p.slope[env], wp.float64(0.0))
    good = wp.isfinite(after)
    if p.progress[env] >= one and not (after <= before + descent + rounding):
        good = False
    if (p.turning[env] != 0 or p.bend[env] > smallest_bend) and p.limit[env] < one:
        good = False
    if good:
        p.waiting[env] = 0
        p.base[env] = p.base_after[env]
        p.progress[env] = p.trial_progress[env]
        p.smallest_step[env] = wp.min(p.smallest_step[env], alpha)
        p.stride[env] = adapted_stride(p.stride[env], alpha)
        return
    p.alpha[env] = wp.float64(0.5) * alpha
    p.cuts[env] += 1
    if p.cuts[env] >= r.max_cuts:
        stop(env, _LINE_SEARCH, p)
    else:
        p.searching[0] = 1


@wp.kernel
def commit_kernel(
    mask: wp.array(dtype=wp.int32),
    trial: wp.array2d(dtype=wp.vec3d),
    trial_poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
):
    """Take over positions and poses in the environments of ``mask``."""
    env, i = wp.tid()
    if mask[env] == 0:
        return
    if i < positions.shape[1]:
        positions[env, i] = trial[env, i]
    if i < poses.shape[1]:
        poses[env, i] = trial_poses[env, i]


# Free flight ---------------------------------------------------------------------------------


@wp.kernel
def choose_flight_kernel(
    bends: wp.array(dtype=wp.float64), least: wp.float64, p: Progress
):
    """Choose the environments in which a body bends its path by more than ``least``."""
    env = wp.tid()
    p.chosen[env] = 0
    if p.active[env] != 0 and bends[env] > least:
        p.chosen[env] = 1


@wp.kernel
def keep_free_flight_kernel(p: Progress):
    """Of the chosen, keep those with nothing in the way."""
    env = wp.tid()
    if p.chosen[env] != 0 and p.limit[env] < wp.float64(1.0):
        p.chosen[env] = 0


@wp.kernel
def accept_flight_kernel(p: Progress):
    """Of the chosen, keep those whose energy falls."""
    env = wp.tid()
    if p.chosen[env] != 0 and not (wp.isfinite(p.after[env]) and p.after[env] < p.before[env]):
        p.chosen[env] = 0
