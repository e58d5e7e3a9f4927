# SPDX-License-Identifier: Apache-2.0
"""Every step of a test taken on a second device, too, from the same state, and compared.

``TACCEL_LAB_BESIDE=cuda:0 pytest tests/verification`` holds a GPU against the CPU on all scenes
that are verified at all. What a step is accurate to is what it was asked for: a part of the contact
force. On a CPU, beside itself, all bits are equal.

Both sides solve their systems by the method that the second device takes. By another one, which
stops elsewhere below the same tolerance, a wedge on a spike falls the other way, and a light plate
lies where its inertia lets the residual put it: that says nothing about the device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.solvers import SolverIPC, StepReport
from taccel_lab.solvers.config import Control
from taccel_lab.state import JointState, State, StepHistory

FORCES_WITHIN = 10.0
"""Difference of the contact force on a body, over the residual that both steps may leave."""
MOTION_WITHIN = 1e-2
"""Difference of positions, over the largest motion in the step."""
LEAST_M = 1e-8
"""Difference of positions that is always allowed, where hardly anything moves [m]."""


@dataclass
class Beside:
    """What was compared."""

    device: str
    steps: int = 0
    left_out: int = 0
    """Steps that were not compared: taken again, or of models whose parameters were changed."""
    worst_force: float = 0.0
    worst_motion: float = 0.0


def moved(state: State, device: str) -> State:
    def there(part: wp.array | StepHistory | JointState | None) -> Any:
        if isinstance(part, StepHistory | JointState):
            return type(part)(*map(there, part.arrays()))
        return None if part is None else wp.clone(part, device=device)

    names = "positions velocities poses history joints external_forces wrenches".split()
    return State(**{name: there(getattr(state, name)) for name in names})


def body_forces(solver: SolverIPC) -> np.ndarray:
    """Resultant of contact and friction on each body [N], shape [env_count, body_count, 3]."""
    nodal = -(solver.contact_gradient.numpy() + solver.friction_gradient.numpy())
    return np.stack([nodal[:, slice(*body.nodes)].sum(axis=1) for body in solver.model.bodies], 1)


@contextmanager
def steps_beside(
    device: str, change: Callable[[SolverIPC], None] = lambda twin: None
) -> Iterator[Beside]:
    """Take all steps within on ``device``, too, on whose solvers ``change`` acts first; compare."""
    found = Beside(device)
    twins: dict[int, tuple[SolverIPC, SolverIPC, SolverIPC]] = {}
    step = SolverIPC.step

    def twins_of(solver: SolverIPC) -> tuple[SolverIPC, SolverIPC]:
        """One on the other device, and one here that solves as that does."""
        if id(solver) not in twins:
            config = replace(solver.config, linear_method="auto")
            away = SolverIPC(solver.model.scene.finalize(device), config)
            change(away)
            config = replace(config, linear_method=away.linear.method)
            here = SolverIPC(solver.model.scene.finalize(str(solver.model.device)), config)
            twins[id(solver)] = (solver, here, away)
        return twins[id(solver)][1:]

    def both(
        self: SolverIPC, state: State, control: Any = None, *, who: Any = None, again: bool = False
    ) -> StepReport:
        model = self.model
        if again or model.changes or model.moves or isinstance(control, Control):
            found.left_out += 1
            return step(self, state, control, who=who, again=again)
        pair = twins_of(self)
        states = [moved(state, str(twin.model.device)) for twin in pair]
        before = state.positions.numpy()
        report = step(self, state, control, who=who)
        poses = control.numpy() if isinstance(control, wp.array) else control
        reports = [
            step(twin, there, poses, who=who) for twin, there in zip(pair, states, strict=True)
        ]
        _compare(found, pair, reports, before, states)
        return report

    SolverIPC.step = both  # type: ignore[method-assign]
    try:
        yield found
    finally:
        SolverIPC.step = step  # type: ignore[method-assign]


def _compare(
    found: Beside,
    solvers: tuple[SolverIPC, SolverIPC],
    reports: list[StepReport],
    before: np.ndarray,
    states: list[State],
) -> None:
    """Where both have converged, in as many parts; where one alone has not, neither should."""
    report, other = reports
    both = report.converged & other.converged & (report.substeps == other.substeps)
    found.steps += 1
    np.testing.assert_array_equal(
        other.converged, report.converged, f"converged on {found.device} (ACTUAL) and here"
    )
    if not both.any():
        return
    here, away = (state.positions.numpy()[both] for state in states)
    motion = np.abs(here - before[both]).max()
    off = np.abs(away - here).max() / max(MOTION_WITHIN * motion, LEAST_M)
    found.worst_motion = max(found.worst_motion, float(off))
    config = solvers[0].config
    scale = np.maximum(report.contact_force_n, other.contact_force_n)[both]
    allowed = FORCES_WITHIN * np.maximum(
        config.relative_tolerance * scale, config.absolute_tolerance_n
    )
    one, two = (body_forces(solver)[both] for solver in solvers)
    worst = float((np.linalg.norm(two - one, axis=-1).max(axis=1) / allowed).max())
    found.worst_force = max(found.worst_force, worst)
    assert off <= 1 and worst <= 1, (
        f"{found.device} and {solvers[0].model.device} differ: positions by {off:.2g} of what is "
        f"allowed, forces by {worst:.2g}"
    )
