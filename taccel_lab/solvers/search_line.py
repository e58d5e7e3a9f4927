# SPDX-License-Identifier: Apache-2.0
"""Stage 4 of an iteration: the longest part of the way ahead that lowers the energy."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.affine.bent_step import (
    LARGEST_TURN,
    SMALLEST_TURN,
    bend_steps,
    find_pivots,
    measure_turns,
)
from taccel_lab.ipc.capacity import ListRoom, overflows
from taccel_lab.ipc.motion import advance_positions, subtract_rows
from taccel_lab.ipc.reduce import slopes
from taccel_lab.ipc.step_limit import limit_step
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.kinematics import place_kinematic_nodes, place_poses_between
from taccel_lab.solvers.env_phase import SEARCHING, enter, leave, stop
from taccel_lab.solvers.env_progress import EnvProgress, Rules
from taccel_lab.solvers.report import EnvStatus
from taccel_lab.solvers.step_launches import StepLaunches

wp.set_module_options({"enable_backward": False})

_LINE_SEARCH = wp.constant(int(EnvStatus.LINE_SEARCH))
_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))
SHARPENING = 0.5
"""What a full step adds to the curvature of friction that the next direction counts."""


@wp.kernel
def _bend_kernel(smallest: wp.float64, p: EnvProgress):
    """Note whether steps are bent, and how far they may lead off the straight ones."""
    env = wp.tid()
    if p.active[env] != 0 and p.bend[env] > smallest:
        p.reach[env] = p.margin[env] + p.deviation[env]
        p.any_curved[0] = 1


@wp.kernel
def _open_search_kernel(largest_turn: wp.float64, p: EnvProgress):
    """Start from the collision-free fraction."""
    env = wp.tid()
    if p.active[env] == 0:
        return
    p.cuts[env] = 0
    alpha = wp.min(p.limit[env], p.damping[env])
    alpha = wp.min(alpha, largest_turn / wp.max(p.bend[env], wp.float64(1.0e-300)))
    p.alpha[env] = alpha
    if alpha > wp.float64(0.0):
        enter(env, SEARCHING, p)
        p.searching[0] = 1
    else:
        # Surfaces that touch show in their gap: this direction is far too long.
        stop(env, _LINE_SEARCH, p)


@wp.kernel
def _begin_trial_kernel(smallest_bend: wp.float64, p: EnvProgress):
    """How far the frames are; ``near`` become those whose way is not the chord that CCD checked."""
    env = wp.tid()
    if env == 0:
        p.searching[0] = 0
    p.near[env] = 0
    if p.inner[env] == 0:
        return
    if p.turning[env] != 0 or p.bend[env] > smallest_bend:
        p.near[env] = 1
        if p.any_curved[0] != 0:
            p.ccd_passes[env] += 1
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
def _accept_kernel(smallest_bend: wp.float64, collisions: ListRoom, p: EnvProgress, r: Rules):
    """Accept a trial that lowers the energy, or halve its fraction.

    While frames are still on their way the energy may rise: they do work. A body that turns leaves
    the chord that CCD checked: where one does, ``limit`` is that of the path really taken.
    Sums of that many terms carry rounding of about 1e-14 of the energy, each element's energy is a
    small difference of terms as large as its shear modulus times its volume, and that of an affine
    body is the square of one.
    """
    env = wp.tid()
    if p.inner[env] == 0:
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
    rounding += r.affine_energy_rounding * wp.sqrt(wp.abs(before))
    descent = wp.float64(1.0e-4) * alpha * wp.min(p.slope[env], wp.float64(0.0))
    good = wp.isfinite(after)
    if p.progress[env] >= one and not (after <= before + descent + rounding):
        good = False
    if (p.turning[env] != 0 or p.bend[env] > smallest_bend) and p.limit[env] < one:
        good = False
    if good:
        leave(env, p)
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


def bend_direction(run: StepLaunches) -> None:
    """How far steps along the direction lead off straight ways, where affine bodies turn."""
    s, p, way = run.s, run.p, run.s.displacements
    if s.affine is not None:
        x = run.state.positions
        find_pivots(run.model, p.active, x, s.contact_gradient, s.pivots)
        measure_turns(run.model, p.active, s.pivots, x, way, p.bend, p.deviation)
        run.decide(_bend_kernel, SMALLEST_TURN, p)


def search_line(run: StepLaunches) -> None:
    """Take the longest fraction of the direction that is free of collisions and lowers the energy.

    While frames are still on their way the energy may rise: they do work.
    """
    s, p, state = run.s, run.p, run.state
    gradients = [s.gradient, s.contact_gradient, s.friction_gradient]
    slopes(p.active, gradients, s.displacements, p.slope)
    run.decide(_open_search_kernel, LARGEST_TURN, p)
    # Only friction that was frozen anew, and joints, change the energy where a search starts.
    run.energy(p.active, state.positions, state.poses, p.base, p.before, known=s.joints is None)

    def cut() -> None:
        evaluate_trial(run)
        run.decide(_accept_kernel, SMALLEST_TURN, s.collisions.room, p, run.rules)

    wp.capture_while(p.searching, cut)
    run.commit(p.active, s.trial, s.trial_poses)


def evaluate_trial(run: StepLaunches) -> None:
    """Positions, poses, collisions and energy at the fraction ``alpha`` of the way ahead, in the
    environments of ``inner``."""
    s, p, state = run.s, run.p, run.state

    def check_path() -> None:
        """Unlike the chord, the way that a turning body takes was not checked."""
        subtract_rows(p.near, s.trial, state.positions, s.path)
        limit_step(run.model, p.near, s.candidates, state.positions, s.path, p.limit)

    run.decide(_begin_trial_kernel, SMALLEST_TURN, p)
    place_poses_between(p.inner, s.start_poses, s.end_poses, p.trial_progress, s.trial_poses)
    advance_positions(p.inner, state.positions, s.displacements, p.alpha, s.trial)
    if s.affine is not None:
        x, way = state.positions, s.displacements
        bend_steps(run.model, p.inner, p.bend, p.alpha, s.pivots, x, way, s.trial)
        embed_vertices(run.model, s.trial)
    place_kinematic_nodes(run.model, s.trial_poses, s.trial, p.inner)
    if run.model.kinematic or s.affine is not None:
        wp.capture_if(p.any_curved, on_true=check_path)
    run.collide(p.inner, s.trial)
    run.energy(p.inner, s.trial, s.trial_poses, p.base_after, p.after)
