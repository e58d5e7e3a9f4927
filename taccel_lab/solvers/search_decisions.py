# SPDX-License-Identifier: Apache-2.0
"""Where each environment looks for its next position, decided on the device: the direction, how far
along it, and a start in free flight. One thread an environment."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.capacity import ListRoom, overflows
from taccel_lab.model.kinematics import turn_within
from taccel_lab.solvers.decisions import stop
from taccel_lab.solvers.env_progress import EnvProgress, Rules
from taccel_lab.solvers.report import EnvStatus

wp.set_module_options({"enable_backward": False})

_LINE_SEARCH = wp.constant(int(EnvStatus.LINE_SEARCH))
_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))
SHARPENING = 0.5
"""What a full step adds to the curvature of friction that the next direction counts."""
LARGEST_BOOST = 64.0
"""Longest step along Newton's direction."""

# The search direction ------------------------------------------------------------------------


@wp.func
def boosted(env: int, p: EnvProgress) -> wp.float64:
    """Four times the last multiple after a full step that hardly lowered the residual, else one.

    Near a saddle, where a gel snaps over an edge, the projected matrix is stiffer than the body:
    whole steps go on for dozens of iterations and each takes the same small part of the way.
    """
    one = wp.float64(1.0)
    if p.progress[env] < one or p.damping[env] < one:
        return one
    ratio = p.excess[env] / p.last_excess[env]
    if ratio < wp.float64(0.7) or ratio > wp.float64(2.0):
        return one
    if p.cuts[env] > 0 or p.alpha[env] < one or p.last_excess[env] == wp.float64(wp.inf):
        return one
    return wp.min(wp.float64(4.0) * p.boost[env], wp.float64(LARGEST_BOOST))


@wp.kernel
def aim_kernel(p: EnvProgress, r: Rules, linear_tolerances: wp.array(dtype=wp.float64)):
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
        turn = wp.max(p.turns[env, body], wp.float64(1.0e-300))
        share = turn_within(p.radii[env, body], gap) / turn
        goal = wp.min(goal, progress + share)
    p.goal[env] = goal
    if progress < one:
        p.moving[env] = 1
    p.boost[env] = boosted(env, p)
    p.last_excess[env] = p.excess[env]
    ratio = one / wp.max(p.excess[env], wp.float64(1.0e-300))
    linear_tolerances[env] = wp.clamp(
        wp.float64(0.3) * ratio, wp.float64(1.0e-6), wp.float64(1.0e-2)
    )


@wp.kernel
def count_solve_kernel(
    iterations: wp.array(dtype=wp.int32),
    breakdown: wp.array(dtype=wp.int32),
    extra: ListRoom,
    p: EnvProgress,
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
        stop(env, _LINE_SEARCH, p)


# The line search -----------------------------------------------------------------------------


@wp.kernel
def bend_kernel(smallest: wp.float64, p: EnvProgress):
    """Note whether steps are bent, and how far they may lead off the straight ones."""
    env = wp.tid()
    if p.active[env] != 0 and p.bend[env] > smallest:
        p.reach[env] = p.margin[env] + p.deviation[env]
        p.any_curved[0] = 1


@wp.kernel
def open_search_kernel(
    largest_turn: wp.float64, node_faces: ListRoom, edge_edges: ListRoom, p: EnvProgress
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
        # Surfaces that touch show in their gap: this direction is far too long.
        stop(env, _LINE_SEARCH, p)


@wp.kernel
def begin_trial_kernel(p: EnvProgress):
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
def accept_kernel(smallest_bend: wp.float64, collisions: ListRoom, p: EnvProgress, r: Rules):
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
        if p.cuts[env] > 0 and p.progress[env] >= one:
            p.sharpness[env] = wp.float64(0.0)
        else:
            p.sharpness[env] = wp.min(p.sharpness[env] + wp.float64(SHARPENING), one)
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
def choose_flight_kernel(bends: wp.array(dtype=wp.float64), least: wp.float64, p: EnvProgress):
    """Choose the environments in which a body bends its path by more than ``least``."""
    env = wp.tid()
    p.chosen[env] = 0
    if p.active[env] != 0 and bends[env] > least:
        p.chosen[env] = 1
        p.any_flight[0] = 1


@wp.kernel
def keep_free_flight_kernel(p: EnvProgress):
    """Of the chosen, keep those with nothing in the way."""
    env = wp.tid()
    if p.chosen[env] != 0 and p.limit[env] < wp.float64(1.0):
        p.chosen[env] = 0


@wp.kernel
def accept_flight_kernel(p: EnvProgress):
    """Of the chosen, keep those whose energy falls."""
    env = wp.tid()
    if p.chosen[env] != 0 and not (wp.isfinite(p.after[env]) and p.after[env] < p.before[env]):
        p.chosen[env] = 0


# Momentum ------------------------------------------------------------------------------------


@wp.kernel
def choose_momentum_kernel(p: EnvProgress):
    """Choose the environments whose frames have yet to move; not in a step that is taken again,
    which has had its momentum."""
    env = wp.tid()
    p.chosen[env] = 0
    fresh = p.active[env] != 0 and p.again[env] == 0
    if fresh and p.progress[env] < wp.float64(1.0):
        p.chosen[env] = 1


@wp.kernel
def accept_momentum_kernel(p: EnvProgress):
    """Of the chosen, keep those without an inverted element; their frames have arrived."""
    env = wp.tid()
    if p.chosen[env] != 0:
        if wp.isfinite(p.after[env]):
            p.progress[env] = wp.float64(1.0)
        else:
            p.chosen[env] = 0
