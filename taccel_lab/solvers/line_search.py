# SPDX-License-Identifier: Apache-2.0
"""How far to go along a Newton direction: CCD first, then the energy, by environment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from taccel_lab.ipc.kinematics import chord_error, interpolate_poses, place_kinematic_nodes
from taccel_lab.ipc.motion import adapted_stride, advance_positions
from taccel_lab.ipc.reduce import dot_rows
from taccel_lab.ipc.step_limit import limit_step
from taccel_lab.solvers.report import EnvStatus

if TYPE_CHECKING:
    from taccel_lab.solvers.newton import StepRun


def search_line(run: StepRun) -> None:
    """Take the longest fraction of the direction that is free of collisions and lowers the energy.

    While frames are still on their way the energy may rise: they do work.
    """
    s, state = run.s, run.state
    margin = s.config.dhat_m
    if run.turning.any():
        margin += chord_error(run.start_poses, run.end_poses, run.model.kinematic_radii_m)
    run.find_candidates(s.target_poses, margin)
    limit_step(run.model, s.active, s.candidates, state.positions, s.displacements, s.alphas)
    alpha = np.minimum(s.alphas.numpy(), run.damping)
    run.stop(run.active & (alpha <= 0), EnvStatus.TOUCHING)
    run.push_active()
    gradient = s.gradient.numpy() + s.contact_gradient.numpy() + s.friction_gradient.numpy()
    slope = dot_rows(gradient, s.displacements.numpy())
    run.collide(state.positions)
    before = run.energy(state.positions, state.poses)
    settled = run.progress >= 1
    waiting = run.active.copy()
    progress = run.progress
    for _ in range(s.config.max_line_search_cuts):
        progress = _trial(run, alpha)
        s.active.assign(waiting.astype(np.int32))
        safe = _rotation_is_safe(run, waiting)
        run.collide(s.trial)
        waiting &= run.active
        after = run.energy(s.trial, s.trial_poses)
        # Sums of that many terms carry rounding of about 1e-14 of the energy, and each element's
        # energy is a small difference of terms as large as its shear modulus times its volume.
        rounding = 1e-13 * np.abs(before) + s.rounding_j
        enough = before + 1e-4 * alpha * np.minimum(slope, 0) + rounding
        good = waiting & safe & np.isfinite(after) & (~settled | (after <= enough))
        waiting &= ~good
        if not waiting.any():
            break
        alpha[waiting] *= 0.5
    moved = run.active & ~waiting
    progress = np.where(moved, progress, run.progress)
    run.stop(waiting, EnvStatus.LINE_SEARCH)
    run.smallest_step[moved] = np.minimum(run.smallest_step[moved], alpha[moved])
    s.active.assign(moved.astype(np.int32))
    alpha[~moved] = 0.0
    _trial(run, alpha)
    run.progress = progress
    run.stride[moved] = adapted_stride(run.stride, alpha)[moved]
    wp.copy(state.positions, s.trial)
    wp.copy(state.poses, s.trial_poses)


def _trial(run: StepRun, alpha: np.ndarray) -> np.ndarray:
    """Positions and poses after a fraction of the direction; returns the new progress."""
    s = run.s
    progress = run.progress + alpha * (run.goal - run.progress)
    progress[progress > 1 - 1e-12] = 1.0
    poses = interpolate_poses(run.start_poses, run.end_poses, progress)
    poses[~run.who] = run.state.poses.numpy().reshape(poses.shape)[~run.who]
    s.trial_poses.assign(poses.reshape(s.trial_poses.shape + (7,)))
    s.alphas.assign(alpha)
    advance_positions(run.state.positions, s.displacements, s.alphas, s.trial)
    place_kinematic_nodes(run.model, s.trial_poses, s.trial)
    return progress


def _rotation_is_safe(run: StepRun, who: np.ndarray) -> np.ndarray:
    """A body that turns leaves the chord that CCD checked: check the path really taken."""
    s = run.s
    if not run.turning.any():
        return np.ones(len(who), dtype=bool)
    path = wp.array(
        s.trial.numpy() - run.state.positions.numpy(),
        dtype=wp.vec3d,
        device=run.model.device,
    )
    limits = wp.zeros(len(who), dtype=wp.float64, device=run.model.device)
    limit_step(run.model, s.active, s.candidates, run.state.positions, path, limits)
    return (limits.numpy() >= 1.0) | ~run.turning
