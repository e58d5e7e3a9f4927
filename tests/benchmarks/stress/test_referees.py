# SPDX-License-Identifier: Apache-2.0
"""Every referee finds the fault it is there for, planted by hand, and nothing in a good step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.benchmarks.stress.balance import Snapshot
from taccel_lab.benchmarks.stress.case import StressCase
from taccel_lab.benchmarks.stress.referees import Referees, StressFinding, Taken, pierces, take
from taccel_lab.benchmarks.stress.shapes import pose
from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import Outputs
from taccel_lab.scene import (
    Ball,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.solvers.step_report import EnvStatus
from taccel_lab.state import State, initial_state

DHAT = 5e-5


class Step:
    """A box presses a gel in one dynamic step; faults are planted into what it left."""

    def __init__(
        self, shape: object = None, expect: Callable | None = None, friction: float = 0.0
    ) -> None:
        gel = SoftBody(
            block_mesh((3, 3, 2), (4e-3, 4e-3, 2e-3), 0.1),
            Material(1e5, 0.4),
            element=Element.LINEAR,
            friction_coefficient=friction,
        )
        tool = shape or box_mesh((1.1e-3, 1.2e-3, 1e-3))
        body = KinematicBody(tool, friction_coefficient=friction)  # type: ignore[arg-type]
        time = TimeStepping(quasi_static=False, dt_s=1e-2)
        config = SolverConfig(dhat_m=DHAT)
        self.case = StressCase(
            Scene(gel, body, time=time), config, 1, pose((0, 0, 6e-4))[None, None], closed=True
        )
        self.case = replace(self.case, expect=expect)
        self.model = self.case.scene.finalize()
        self.solver = SolverIPC(self.model, config)
        self.state: State = initial_state(self.model, self.case.start)
        self.referees = Referees(self.case, self.model, config)
        outputs = Outputs(self.solver)
        still = self.state.poses.numpy().reshape(1, 1, 7).copy()
        first = take(self.solver, outputs, self.state, still, True, None)
        assert self.referees.findings(first, self.state, 0) == []
        aside = 1e-4 if friction else 0.0
        target = pose((aside, 0, 3e-4))[None, None]
        self.taken: Taken = take(self.solver, outputs, self.state, target, True, first)
        assert self.taken.report.converged.all()
        self.taken = replace(self.taken, energies_before=self.taken.energies)

    def judged(self) -> set[str]:
        return {finding.referee for finding in self.findings()}

    def findings(self) -> list[StressFinding]:
        return self.referees.findings(self.taken, self.state, 1)

    def move(self, change: Callable[[np.ndarray], None]) -> None:
        """Change the positions that the step is said to have left."""
        x = self.state.positions.numpy().copy()
        change(x[0])
        self.state.positions.assign(x)
        self.taken = replace(self.taken, now=Snapshot.of(self.state))

    def status(self, status: EnvStatus) -> None:
        report = replace(self.taken.report, status=np.array([int(status)]))
        self.taken = replace(self.taken, report=report)


BALL = Ball(5.5e-4)


@pytest.mark.parametrize(
    ("shape", "friction"), [(None, 0.0), (None, 0.5), (BALL, 0.0), (BALL, 0.5)]
)
def test_a_good_step_is_good(shape: object, friction: float) -> None:
    step = Step(shape, friction=friction)
    assert step.findings() == []
    assert step.referees.balanced_steps == 2
    assert 0 < step.referees.residual_ratio < 1
    assert np.abs(step.taken.normal).max() > 0
    assert (np.abs(step.taken.friction).max() > 0) == (friction > 0)


def sink(step: Step, way_m: float) -> None:
    """Push the tool into the gel."""

    def down(x: np.ndarray) -> None:
        x[step.model.bodies[1].node_slice, 2] -= way_m

    step.move(down)


def flip_a_tet(step: Step) -> None:
    inner = np.flatnonzero(step.model.free_index.numpy() >= 0)
    rest = step.model.rest_positions.numpy()[0, inner]
    node = inner[np.linalg.norm(rest - [0, 0, -1e-3], axis=1).argmin()]
    shift(step, node, 3e-3)


def shift(step: Step, node: int, way_m: float) -> None:
    """Move one node along x."""

    def aside(x: np.ndarray) -> None:
        x[node, 0] += way_m

    step.move(aside)


def see_no_contact(step: Step) -> None:
    report = replace(step.taken.report, min_distance_m=np.array([0.5 * DHAT]))
    x = step.state.positions.numpy()[0]
    near = step.referees.surfaces.nearer_than(x, np.ones(2, dtype=bool), 0.4 * DHAT)
    assert len(near.gaps_m), "the box must be near enough"
    step.taken = replace(step.taken, report=report)


def push_without_reaction(step: Step) -> None:
    normal = step.taken.normal.copy()
    normal[0, step.model.bodies[1].node_slice] *= 1.001
    step.taken = replace(step.taken, normal=normal)


def scale(step: Step, name: str, factor: float) -> None:
    step.taken = replace(step.taken, **{name: factor * getattr(step.taken, name)})


def halve_the_limit(step: Step) -> None:
    frozen = step.taken.frozen
    assert frozen is not None
    frozen.mu_lambdas.assign(0.5 * frozen.mu_lambdas.numpy())


def drop_a_pair(step: Step) -> None:
    pairs = [{name: values[1:] for name, values in step.taken.pairs[0].items()}]
    step.taken = replace(step.taken, pairs=pairs)


def miss_the_target(step: Step) -> None:
    target = step.taken.target.copy()
    target[0, 0, 0] += 1e-9
    step.taken = replace(step.taken, target=target)


def double_the_energy(step: Step) -> None:
    energies = {name: 2.0 * value for name, value in step.taken.energies.items()}
    step.taken = replace(step.taken, energies=energies)


@pytest.mark.parametrize(
    ("shape", "friction", "fault", "found", "alone"),
    [
        (None, 0.0, lambda s: sink(s, 2e-4), {"intersection"}, False),
        (BALL, 0.0, lambda s: sink(s, 1e-4), {"intersection", "gap"}, False),
        (None, 0.0, flip_a_tet, {"inversion"}, False),
        (None, 0.0, lambda s: shift(s, 5, np.nan), {"not a number"}, True),
        (None, 0.0, lambda s: shift(s, s.model.free_nodes.numpy()[-1], 1e-7), {"residual"}, False),
        (None, 0.0, see_no_contact, {"missed contact"}, True),
        (None, 0.0, push_without_reaction, {"reaction"}, False),
        *[
            (None, 0.5, lambda s, n=name, f=factor: scale(s, n, f), {law}, False)
            for name, law in (("normal", "contact law"), ("friction", "friction law"))
            for factor in (1.001, 0.5, -1.0)
        ],
        (None, 0.5, halve_the_limit, {"friction law", "friction limit"}, False),
        (None, 0.5, drop_a_pair, {"contact law", "friction limit"}, False),
        (None, 0.0, miss_the_target, {"target"}, True),
        (None, 0.0, double_the_energy, {"energy"}, True),
    ],
)
def test_a_fault_is_found_by_its_referee(
    shape: object, friction: float, fault: Callable[[Step], None], found: set[str], alone: bool
) -> None:
    step = Step(shape, friction=friction)
    fault(step)
    judged = step.judged()
    assert judged == found if alone else found <= judged


def test_a_failure_that_was_not_rolled_back() -> None:
    step = Step()
    step.status(EnvStatus.NO_CONVERGENCE)
    assert step.judged() == {"rollback"}
    back = step.taken.before
    step.state.positions.assign(back.positions)
    step.state.velocities.assign(back.velocities)
    step.state.poses.assign(back.poses)
    step.taken = replace(step.taken, now=Snapshot.of(step.state))
    assert step.findings() == []


def test_an_expectation_of_the_family() -> None:
    step = Step(expect=lambda model, state, number: None if number == 0 else "it is gone")
    assert [str(finding) for finding in step.findings()] == [
        "expectation (environment 0): it is gone"
    ]


def test_exact_crossings() -> None:
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    through = np.array([[0.2, 0.2, -1e-300], [0.2, 0.2, 1e-300]])
    assert pierces(through, triangle)
    assert not pierces(through + [1.0, 0, 0], triangle)
    # Beside it by the last digit, and in its plane.
    edge = np.array([[0.5 + 2e-16, 0.5, -1.0], [0.5 + 2e-16, 0.5, 1.0]])
    assert not pierces(edge, triangle)
    assert not pierces(np.array([[0.1, 0.1, 0], [0.2, 0.3, 0]]), triangle)
