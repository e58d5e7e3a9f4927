# SPDX-License-Identifier: Apache-2.0
"""Directions that count how friction follows the contacts.

Frozen friction makes the matrix symmetric and the step a minimum; freezing anew is a fixed-point
iteration. Where edges rub it leaves 0.92 of the residual each time, or alternates. Once a freezing
was slow, friction is frozen where an environment is, and the residual has come down to a part of
the contact force, the direction is that of the whole derivative instead (``friction_change``),
which leaves a tenth of the residual near the solution. ``CorrectedSolve`` finds it by systems with
frozen friction. No energy falls along it: what it is worth is judged by the residual with friction
frozen where it leads (``friction_lag``).
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.motion.unknowns import reduce_gradient, spread_solution
from taccel_lab.ipc.potentials.friction_change import add_friction_change
from taccel_lab.model.env_rows import copy_rows, zero_rows
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.step_launches import StepLaunches

wp.set_module_options({"enable_backward": False})

SLOW = 0.3
"""Part of the residual that some freezing of the step has left where directions follow friction.
Those cost several solves, and under balls freezing leaves less."""
FOLLOW_BELOW = 0.1
"""Residual over contact force below which directions follow friction."""


@wp.func
def follows_friction(env: int, p: Progress):
    """Choose whether the next direction follows friction: where that is frozen at the positions,
    and matrices are not projected. With joints it does not: their forces have rounds of their own.
    """
    p.following.follows[env] = 0
    if (
        p.rules.has_friction == 0
        or p.rules.has_joints != 0
        or p.counts.lags[env] < p.rules.follow_after
    ):
        return
    if p.following.left[env] < wp.float64(SLOW):
        return
    if p.following.pause[env] > 0:
        p.following.pause[env] -= 1
        return
    if p.prescribed.progress[env] < wp.float64(1.0) or p.curvature.projected[env] > 0:
        return
    if wp.isfinite(p.balance.last_residual[env]):
        return
    if p.rules.relative_tolerance * p.balance.excess[env] < wp.float64(FOLLOW_BELOW):
        p.following.follows[env] = 1
        p.following.share[env] = wp.float64(1.0)
        p.following.excess_before[env] = p.balance.excess[env]


def follow_friction(run: StepLaunches) -> None:
    """Turn the directions with frozen friction, where they shall follow it, into those of the whole
    derivative."""
    s, p = run.s, run.p
    assert s.friction is not None and s.corrected is not None
    friction, corrected, displacements = s.friction, s.corrected, s.displacements
    follows = p.following.follows
    copy_rows(follows, run.state.positions, s.follow_start)

    def change(mask: wp.array) -> None:
        spread_solution(run.model, mask, s.linear.solution, displacements)
        zero_rows(mask, s.friction_change)
        sharpness = p.curvature.sharpness
        add_friction_change(
            friction, mask, run.motion(), sharpness, displacements, s.friction_change
        )
        reduce_gradient(run.model, mask, [s.friction_change], corrected.changes)

    corrected.solve(follows, change, s.config.max_cg_iterations, p.counts.cg)
    spread_solution(run.model, follows, s.linear.solution, displacements)
