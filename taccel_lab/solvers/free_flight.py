# SPDX-License-Identifier: Apache-2.0
"""A start for Newton's method where affine bodies turn: rigid free flight, with joints closed.

Straight steps have to follow the curved set of rotations in short pieces; a body of 1 GPa that
turns by 0.04 a step takes 16 of them, and one from here. The start is taken where nothing is in the
way and the energy is lower; else Newton starts from where the bodies are, as ever.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.affine.prediction import predict_affine
from taccel_lab.ipc.motion import advance_positions, subtract_rows
from taccel_lab.ipc.step_limit import limit_step
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.env_rows import copy_rows
from taccel_lab.solvers import search_decisions
from taccel_lab.solvers.step_launches import StepLaunches

_SMALL_TURN_SQ = 1e-6
"""Angle squared below which straight steps are as good."""


def start_in_free_flight(run: StepLaunches) -> None:
    """Move the state of the active environments to free flight where that is a better start."""
    s, p, x = run.s, run.p, run.state.positions
    if s.inertia is None or s.affine is None:
        return
    copy_rows(p.active, x, s.trial)
    predict_affine(run.model, p.active, s.inertia.predictions, s.trial, p.limit)
    p.any_flight.zero_()
    run.decide(search_decisions.choose_flight_kernel, p.limit, _SMALL_TURN_SQ, p)

    def fly() -> None:
        _fly(run)

    wp.capture_if(p.any_flight, on_true=fly)


def _fly(run: StepLaunches) -> None:
    """Try the flight of the chosen environments, whose control nodes are in ``trial``."""
    s, p, x, poses = run.s, run.p, run.state.positions, run.state.poses
    if s.joints is not None:
        s.joints.set_frames(poses)
        s.joints.close_predicted(p.chosen, s.trial)
    subtract_rows(p.chosen, s.trial, x, s.displacements)
    embed_vertices(run.model, s.displacements)
    # Of all active environments: those that are not chosen keep their list, too.
    run.find_candidates(poses, p.margin)
    run.check_room(p.active, s.candidates.lists)
    limit_step(run.model, p.chosen, s.candidates, x, s.displacements, p.limit)
    run.decide(search_decisions.keep_free_flight_kernel, p)
    run.energy(p.chosen, x, poses, p.base, p.before)
    p.alpha.fill_(1.0)
    advance_positions(p.chosen, x, s.displacements, p.alpha, s.trial)
    run.collide(p.chosen, s.trial)
    run.check_room(p.chosen, [s.collisions])
    run.energy(p.chosen, s.trial, poses, p.base_after, p.after)
    run.decide(search_decisions.accept_flight_kernel, p)
    copy_rows(p.chosen, s.trial, x)
    run.collide(p.active, x)
    run.check_room(p.active, [s.collisions])
