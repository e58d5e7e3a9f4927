# SPDX-License-Identifier: Apache-2.0
"""A start for Newton's method where affine bodies turn: rigid free flight, with joints closed.

Straight steps have to follow the curved set of rotations in short pieces; a body of 1 GPa that
turns by 0.04 a step takes 16 of them, and one from here. The start is taken where nothing is in the
way and the energy is lower; else Newton starts from where the bodies are, as ever.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from taccel_lab.ipc.affine.embedding import embed_vertices
from taccel_lab.ipc.affine.prediction import predict_affine
from taccel_lab.ipc.motion import advance_positions
from taccel_lab.ipc.step_limit import limit_step

if TYPE_CHECKING:
    from taccel_lab.solvers.newton import StepRun

_SMALL_TURN_SQ = 1e-6
"""Angle squared below which straight steps are as good."""


def start_in_free_flight(run: StepRun) -> None:
    """Move the state of the active environments to free flight where that is a better start."""
    s, x, poses = run.s, run.state.positions, run.state.poses
    if s.inertia is None or s.affine is None:
        return
    wp.copy(s.trial, x)
    bends = predict_affine(run.model, s.active, s.inertia.predictions, s.trial)
    tried = run.active & (bends > _SMALL_TURN_SQ)
    if not tried.any():
        return
    s.active.assign(tried.astype(np.int32))
    if s.joints is not None:
        s.joints.set_frames(poses)
        s.joints.close_predicted(s.active, s.trial)
    s.displacements.assign(np.where(tried[:, None, None], s.trial.numpy() - x.numpy(), 0.0))
    embed_vertices(run.model, s.displacements)
    # Of all active environments: those that are not tried keep their list, too.
    run.push_active()
    run.find_candidates(poses, s.config.dhat_m)
    s.active.assign(tried.astype(np.int32))
    limit_step(run.model, s.active, s.candidates, x, s.displacements, s.alphas)
    tried &= s.alphas.numpy() >= 1.0
    s.active.assign(tried.astype(np.int32))
    s.collisions.update(s.active, x, s.candidates)
    before = run.energy(x, poses)
    s.alphas.assign(tried.astype(np.float64))
    advance_positions(x, s.displacements, s.alphas, s.trial)
    s.collisions.update(s.active, s.trial, s.candidates)
    after = run.energy(s.trial, poses)
    tried &= np.isfinite(after) & (after < before)
    s.alphas.assign(tried.astype(np.float64))
    advance_positions(x, s.displacements, s.alphas, s.trial)
    wp.copy(x, s.trial)
    run.push_active()
