# SPDX-License-Identifier: Apache-2.0
"""Stage 4 of an iteration: the longest part of the way ahead that lowers the energy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp

from taccel_lab.ipc.affine.bent_step import find_pivots, measure_turns, place_affine
from taccel_lab.ipc.contact.step_limit import limit_checks
from taccel_lab.ipc.device.ragged_lists import ListRoom, overflows
from taccel_lab.ipc.device.sums import BLOCK_THREADS, block_slope
from taccel_lab.ipc.motion.trial import Trial
from taccel_lab.ipc.potentials.energy import WrittenEnergies, block_base, block_friction
from taccel_lab.model.env_lists import Envs, ListedMask, env_at
from taccel_lab.model.launches import launch, launch_blocks
from taccel_lab.solvers.env_phase import SEARCHING, count_on, enter, leave, stop
from taccel_lab.solvers.env_progress import NO_LIMIT, Progress, lower_flags
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})

_LINE_SEARCH = wp.constant(int(EnvStatus.LINE_SEARCH))
_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))
SHARPENING = 0.5
"""What a full step adds to the curvature of friction that the next direction counts."""


@wp.func
def begin_trial(env: int, collisions: ListRoom, p: Progress):
    """How far the frames are in the next trial, whose collisions are not known yet."""
    collisions.counts[env] = 0
    progress = p.prescribed.progress[env] + p.search.alpha[env] * (
        p.prescribed.goal[env] - p.prescribed.progress[env]
    )
    if progress > wp.float64(1.0 - 1.0e-12):
        progress = wp.float64(1.0)
    p.prescribed.trial_progress[env] = progress


@wp.func
def search_on(env: int, collisions: ListRoom, p: Progress):
    """Try the fraction ``alpha``; ``strays`` if its path is to be checked."""
    begin_trial(env, collisions, p)
    if p.search.alpha[env] > p.clearance.safe[env]:
        p.search.strays[env] = 1
        p.search.free[env] = wp.float64(1.0)
        p.counts.ccd_passes[env] += 1


@wp.kernel
def _open_search_kernel(
    stepping: Envs,
    gradient: wp.array2d(dtype=wp.vec3d),
    contact_gradient: wp.array2d(dtype=wp.vec3d),
    friction_gradient: wp.array2d(dtype=wp.vec3d),
    direction: wp.array2d(dtype=wp.vec3d),
    energies: WrittenEnergies,
    base_known: int,
    collisions: ListRoom,
    p: Progress,
):
    """Slope and energy where the search starts; the first trial takes the collision-free fraction.

    One thread block an environment, of which the first thread decides when all have added up.
    """
    place, lane = wp.tid()
    env = env_at(place, stepping)
    if env < 0:
        return
    slope = block_slope(env, lane, gradient, contact_gradient, friction_gradient, direction)
    if base_known == 0:
        base = block_base(env, lane, energies)
        if lane == 0:
            p.search.base[env] = base
    friction = block_friction(env, lane, energies)
    if lane == 0:
        p.search.derivative[env] = slope
        p.search.before[env] = p.search.base[env] + friction
        p.search.strays[env] = 0
        p.search.cuts[env] = 0
        alpha = wp.min(p.clearance.limit[env], p.balance.damping[env])
        p.search.alpha[env] = alpha
        if alpha > wp.float64(0.0):
            enter(env, SEARCHING, p)
            search_on(env, collisions, p)
        else:
            # Surfaces that touch show in their gap: this direction is far too long.
            stop(env, _LINE_SEARCH, p)


@wp.func
def adapted_stride(stride: wp.float64, fraction: wp.float64) -> wp.float64:
    """Part of the remaining motion to ask for next, after ``fraction`` of the last was accepted.

    The gel's answer is linear in the motion asked for. Cutting the direction again and again
    instead uses up most of the gap each time, until the barrier is too stiff to recover.
    """
    if fraction < wp.float64(0.1):
        return wp.max(wp.float64(0.25) * stride, wp.float64(1.0e-9))
    if fraction >= wp.float64(0.5):
        return wp.min(wp.float64(2.0) * stride, wp.float64(1.0))
    return stride


@wp.func
def is_good(env: int, p: Progress) -> bool:
    """Whether a trial lowers the energy.

    While frames are still on their way the energy may rise: they do work.
    A body that turns leaves the chord that CCD checked: where one does, ``free`` is that of the
    path really taken.
    Sums of that many terms carry rounding of about 1e-14 of the energy, each element's energy is a
    small difference of terms as large as its shear modulus times its volume, and that of an affine
    body is the square of one.
    """
    one = wp.float64(1.0)
    before = p.search.before[env]
    after = p.search.after[env]
    rounding = p.search.energy_rounding[env] + p.search.joint_energy_rounding[env]
    rounding += wp.float64(1.0e-13) * wp.abs(before)
    rounding += p.rules.affine_energy_rounding * wp.sqrt(wp.abs(before))
    descent = (
        wp.float64(1.0e-4) * p.search.alpha[env] * wp.min(p.search.derivative[env], wp.float64(0.0))
    )
    good = wp.isfinite(after)
    arrived = p.prescribed.progress[env] >= one
    if arrived and not (after <= before + descent + rounding):
        good = False
    if p.search.strays[env] != 0 and p.search.free[env] < one:
        good = False
    return good


@wp.func
def accept(env: int, p: Progress):
    """Take over a trial."""
    one = wp.float64(1.0)
    alpha = p.search.alpha[env]
    leave(env, p)
    p.search.base[env] = p.search.base_after[env]
    p.prescribed.progress[env] = p.prescribed.trial_progress[env]
    p.search.smallest_step[env] = wp.min(p.search.smallest_step[env], alpha)
    p.prescribed.stride[env] = adapted_stride(p.prescribed.stride[env], alpha)
    if p.search.cuts[env] > 0 and p.prescribed.progress[env] >= one:
        p.curvature.sharpness[env] = wp.float64(0.0)
    else:
        p.curvature.sharpness[env] = wp.min(
            p.curvature.sharpness[env] + wp.float64(SHARPENING), one
        )


@wp.func
def judge_trial(env: int, collisions: ListRoom, p: Progress):
    """Accept a trial, or halve its fraction for the next round."""
    good = is_good(env, p)
    p.search.strays[env] = 0
    if overflows(env, collisions):
        stop(env, _CONTACT_OVERFLOW, p)
    elif good:
        accept(env, p)
    else:
        p.search.alpha[env] = wp.float64(0.5) * p.search.alpha[env]
        p.search.cuts[env] += 1
        if p.search.cuts[env] >= p.rules.max_cuts:
            stop(env, _LINE_SEARCH, p)
        else:
            search_on(env, collisions, p)
            count_on(env, p)
            # At its own pace nobody waits: what a call does must not depend on how many are left.
            if p.flags.most_rounds[0] == NO_LIMIT:
                p.flags.search_goes_on[0] = 1


@wp.kernel
def _begin_trials_kernel(p: Progress):
    """Begin to count who takes part in the next round."""
    p.flags.rounds[wp.tid()] += 1
    lower_flags(p)


@wp.kernel
def _judge_trial_kernel(
    searching: Envs,
    energies: WrittenEnergies,
    collisions: ListRoom,
    p: Progress,
):
    """The energy of a trial, and its outcome; threads as in ``_open_search_kernel``."""
    place, lane = wp.tid()
    env = env_at(place, searching)
    if env < 0:
        return
    base = block_base(env, lane, energies)
    friction = block_friction(env, lane, energies)
    if lane == 0:
        p.search.base_after[env] = base
        p.search.after[env] = base + friction
        judge_trial(env, collisions, p)


def find_turning_points(run: StepLaunches) -> list[Callable[[], None]]:
    """Launches that find what affine bodies turn about, for ``bend_direction``: known before the
    direction is, so that they run beside the assembly."""
    s = run.s
    if s.affine is None:
        return []
    x, forces = run.state.positions, s.contact_gradient
    return [lambda: find_pivots(run.model, run.stepping, x, forces, s.pivots)]


def bend_direction(run: StepLaunches) -> None:
    """How far steps along the direction lead off straight ways, where affine bodies turn."""
    s, p, x = run.s, run.p, run.state.positions
    if s.affine is not None:
        measure_turns(
            run.model,
            run.stepping,
            s.pivots,
            x,
            s.displacements,
            p.clearance.bend,
            p.clearance.reach,
        )


def energies_at_start(run: StepLaunches) -> list[Callable[[], None]]:
    """Launches that write the energies where the search starts.

    Only friction that was frozen anew, and joints, change them since they were last summed.
    """
    s, state = run.s, run.state
    if s.joints is None:
        return [lambda: run.friction_energy(run.stepping, state.positions, state.poses)]
    return run.all_energies(run.stepping, state.positions, state.poses)


def open_search(run: StepLaunches) -> None:
    """Begin to look for the longest fraction of the direction that is free of collisions and lowers
    the energy, in the environments that are stepping. ``energies_at_start`` are written.

    While frames are still on their way the energy may rise: they do work.
    """
    s, p = run.s, run.p
    gradients = [s.gradient, s.contact_gradient, s.friction_gradient]
    known = int(s.joints is None)
    start = [run.stepping, *gradients, s.displacements, run.energies, known]
    start += [s.collisions.room, p.struct]
    launch_blocks(_open_search_kernel, run.model.env_count, *start)


def try_fraction(run: StepLaunches) -> None:
    """Evaluate and judge one trial of each search: ``trial`` where it is accepted.

    One a round, where many are left. Of a hundred directions 98 are taken at once, and of hundreds
    of environments some try a fourth time: the others do not wait for them.
    """

    def begin() -> None:
        launch(_begin_trials_kernel, 1, run.p.struct, device=run.model.device)

    place_trial(run, run.searching, beside=[begin])
    evaluate_trial(run, run.searching, beside=check_paths(run))
    inputs = [run.searching, run.energies, run.s.collisions.room, run.p.struct]
    launch_blocks(_judge_trial_kernel, run.model.env_count, *inputs)


def place_trial(
    run: StepLaunches, mask: ListedMask, beside: Sequence[Callable[[], None]] = ()
) -> None:
    """Positions and poses at the fraction ``alpha`` of the way ahead, in the environments of
    ``mask``. ``beside``: what else may be launched meanwhile."""
    s, p = run.s, run.p
    trial = Trial()
    trial.curved, trial.fractions = p.search.strays, p.search.alpha
    trial.positions, trial.displacements = run.state.positions, s.displacements
    trial.result, trial.paths = s.trial, s.path
    path = (s.start_poses, s.end_poses)

    def place_affine_bodies() -> None:
        if s.affine is not None:
            place_affine(run.model, mask, p.clearance.bend, s.pivots, trial)

    run.together(
        [
            lambda: s.straight_nodes.place(mask, trial),
            lambda: s.frame_nodes.place(
                mask, trial, path, p.prescribed.trial_progress, s.trial_poses
            ),
            place_affine_bodies,
            *beside,
        ]
    )


def check_paths(run: StepLaunches) -> list[Callable[[], None]]:
    """Launches that find ``free`` where a trial ``strays``: the way that a turning body takes was
    not checked, unlike the chord."""
    s, p = run.s, run.p
    if not (run.model.kinematic or s.affine is not None):
        return []
    strays, x = run.those(p.search.strays), run.state.positions
    return limit_checks(run.model, strays, s.candidates, x, s.path, p.search.free)


def evaluate_trial(
    run: StepLaunches, mask: ListedMask, beside: Sequence[Callable[[], None]] = ()
) -> None:
    """Collisions and energies of a trial in the environments of ``mask``, whose lists of collisions
    are empty. ``beside``: what else may be launched meanwhile."""
    s = run.s
    energies = run.energy_parts(mask, s.trial, s.trial_poses)
    searches = s.collisions.searches(mask, s.trial, s.candidates)
    run.together([*searches, *beside, *energies])
    s.collisions.settle(mask)
    s.contact.write_energies(mask, s.trial)
