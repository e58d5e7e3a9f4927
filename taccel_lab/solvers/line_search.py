# SPDX-License-Identifier: Apache-2.0
"""How far to go along a Newton direction: CCD first, then the energy, by environment."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.affine.bent_step import (
    LARGEST_TURN,
    SMALLEST_TURN,
    bend_steps,
    find_pivots,
    measure_turns,
)
from taccel_lab.ipc.motion import advance_positions, subtract_rows
from taccel_lab.ipc.reduce import slopes
from taccel_lab.ipc.step_limit import limit_step
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.kinematics import place_kinematic_nodes, place_poses_between
from taccel_lab.solvers import search_decisions
from taccel_lab.solvers.step_launches import StepLaunches


def search_line(run: StepLaunches) -> None:
    """Take the longest fraction of the direction that is free of collisions and lowers the energy.

    While frames are still on their way the energy may rise: they do work.
    """
    s, p, state = run.s, run.p, run.state
    if s.affine is not None:
        x, way = state.positions, s.displacements
        find_pivots(run.model, p.active, x, s.contact_gradient, s.pivots)
        measure_turns(run.model, p.active, s.pivots, x, way, p.bend, p.deviation)
        run.decide(search_decisions.bend_kernel, SMALLEST_TURN, p)
    run.find_candidates(s.target_poses, p.reach)
    limit_step(run.model, p.active, s.candidates, state.positions, s.displacements, p.limit)
    gradients = [s.gradient, s.contact_gradient, s.friction_gradient]
    slopes(p.active, gradients, s.displacements, p.slope)
    rooms = [part.room for part in s.candidates.lists]
    run.decide(search_decisions.open_search_kernel, LARGEST_TURN, *rooms, p)
    # Only friction that was frozen anew, and joints, change the energy where a search starts.
    run.energy(p.active, state.positions, state.poses, p.base, p.before, known=s.joints is None)

    def cut() -> None:
        _try(run)

    wp.capture_while(p.searching, cut)
    run.commit(p.active, s.trial, s.trial_poses)


def _try(run: StepLaunches) -> None:
    """Try the fraction ``alpha`` in the environments that are waiting."""
    s, p, state = run.s, run.p, run.state

    def check_path() -> None:
        """Unlike the chord, the way that a turning body takes was not checked."""
        subtract_rows(p.waiting, s.trial, state.positions, s.path)
        limit_step(run.model, p.waiting, s.candidates, state.positions, s.path, p.limit)

    run.decide(search_decisions.begin_trial_kernel, p)
    place_poses_between(p.waiting, s.start_poses, s.end_poses, p.trial_progress, s.trial_poses)
    advance_positions(p.waiting, state.positions, s.displacements, p.alpha, s.trial)
    if s.affine is not None:
        x, way = state.positions, s.displacements
        bend_steps(run.model, p.waiting, p.bend, p.alpha, s.pivots, x, way, s.trial)
        embed_vertices(run.model, s.trial)
    place_kinematic_nodes(run.model, s.trial_poses, s.trial, p.waiting)
    if run.model.kinematic or s.affine is not None:
        wp.capture_if(p.any_curved, on_true=check_path)
    run.collide(p.waiting, s.trial)
    run.energy(p.waiting, s.trial, s.trial_poses, p.base_after, p.after)
    run.decide(search_decisions.accept_kernel, SMALLEST_TURN, s.collisions.room, p, run.rules)
