# SPDX-License-Identifier: Apache-2.0
"""A start for Newton's method where frames move: everything goes on as in the last step.

In a steady motion, a grasp that is carried or a gel that is dragged, the last velocities are all
but the answer, and one Newton iteration in three is saved. The start is taken where frames move as
in the last step and nothing is in the way of anything; else Newton starts from where the bodies
are, and takes the frames along.
"""

from __future__ import annotations

from taccel_lab.ipc.motion import advance_positions, aim_prescribed, coast, keep_steady
from taccel_lab.ipc.step_limit import limit_step
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.solvers import search_decisions
from taccel_lab.solvers.step_launches import StepLaunches

_LARGEST_CHANGE = 0.5
"""Change of the frames' way from one step to the next up to which they move steadily."""


def start_with_momentum(run: StepLaunches) -> None:
    """Move bodies by their velocities and frames to their targets where both are free to go."""
    s, p, state = run.s, run.p, run.state
    x = state.positions
    if not run.model.kinematic:
        return
    run.decide(search_decisions.choose_momentum_kernel, p)
    aim_prescribed(run.model, p.active, p.chosen, x, s.end_poses, s.displacements)
    velocities = state.velocities
    keep_steady(run.model, p.chosen, s.dts, velocities, s.displacements, _LARGEST_CHANGE)
    coast(run.model, p.chosen, s.dts, velocities, s.displacements)
    embed_vertices(run.model, s.displacements)
    # Of all active environments: those that are not chosen keep their list, too.
    run.find_candidates(s.end_poses, p.margin)
    run.check_room(p.active, s.candidates.lists)
    limit_step(run.model, p.chosen, s.candidates, x, s.displacements, p.limit)
    run.decide(search_decisions.keep_free_flight_kernel, p)
    p.alpha.fill_(1.0)
    advance_positions(p.chosen, x, s.displacements, p.alpha, s.trial)
    run.collide(p.chosen, s.trial)
    run.check_room(p.chosen, [s.collisions])
    run.energy(p.chosen, s.trial, s.end_poses, p.base_after, p.after)
    run.decide(search_decisions.accept_momentum_kernel, p)
    run.commit(p.chosen, s.trial, s.end_poses)
    run.collide(p.active, x)
    run.check_room(p.active, [s.collisions])
