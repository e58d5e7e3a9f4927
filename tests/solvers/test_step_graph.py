# SPDX-License-Identifier: Apache-2.0
"""Captured steps: the same bits as launches one by one, whatever becomes of the arrays."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.scene import KinematicBody, Material, Scene, TimeStepping
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state
from tests.support.blocks import cube, pose, soft_block

STEPS = 6


def cube_on_a_gel(env_count: int = 2) -> Scene:
    """A gel on a mount under a free cube."""
    gel = soft_block((4, 4, 2), (6e-3, 6e-3, 3e-3), mount="hand", friction_coefficient=0.5)
    box = cube(3e-3, pose(0.2e-3, 0, 1.58e-3), friction_coefficient=0.5)
    time = TimeStepping(quasi_static=False, dt_s=2e-3, gravity_m_s2=(0.0, 0.0, -9.81))
    hand = KinematicBody(None, name="hand")
    return Scene([gel], [hand], env_count, time, affine_bodies=[box])


def poses(step: int, env_count: int = 2) -> np.ndarray:
    """The mount goes sideways and turns, each environment at its own pace."""
    pace = 1 + np.arange(env_count)
    angle = 4e-3 * step * pace
    zero = np.zeros(env_count)
    columns = [1e-4 * step * pace, zero, zero, zero, zero, np.sin(angle / 2), np.cos(angle / 2)]
    return np.stack(columns, axis=1)[:, None]


def make(**options: object) -> tuple[SolverIPC, State]:
    model = cube_on_a_gel().finalize()
    config = SolverConfig(dhat_m=1e-4, **options)  # type: ignore[arg-type]
    return SolverIPC(model, config), initial_state(model, poses(0))


def run(solver: SolverIPC, state: State) -> np.ndarray:
    for step in range(1, STEPS):
        report = solver.step(state, poses(step))
        assert report.converged.all(), report.summary()
    return np.concatenate(
        [a.numpy().ravel() for a in (state.positions, state.velocities, solver.contact_gradient)]
    )


@pytest.fixture(scope="module")
def eager() -> np.ndarray:
    solver, state = make(capture=False)
    result = run(solver, state)
    assert solver.graph.launches == 0
    return result


@pytest.mark.thorough
def test_a_captured_run_is_bitwise_the_same(eager: np.ndarray) -> None:
    solver, state = make()
    np.testing.assert_array_equal(run(solver, state), eager)
    # The first step comes as it is.
    assert solver.graph.launches == STEPS - 2


def gel_on_gel() -> Scene:
    """A gel on a mount above another one, out of reach."""
    cells, size = (3, 3, 2), (5e-3, 5e-3, 3e-3)
    lower = soft_block(cells, size, name="lower", friction_coefficient=0.5)
    upper = soft_block(
        cells, size, Material(5e4, 0.4), name="upper", mount="hand", friction_coefficient=0.5
    )
    return Scene([lower, upper], [KinematicBody(None, name="hand")])


@pytest.mark.thorough
@pytest.mark.parametrize("first_contact", [1, 5])
def test_trees_of_soft_bodies_are_refitted_in_a_graph(first_contact: int) -> None:
    """Also where the graph is recorded while they are out of reach, and searches no tree."""
    heights = np.concatenate([np.linspace(1e-3, 2e-4, first_contact), -1e-4 * np.arange(1, 7)])
    ends = []
    for capture in (False, True):
        model = gel_on_gel().finalize()
        solver = SolverIPC(model, SolverConfig(dhat_m=5e-5, capture=capture))
        targets = [
            np.array([[[3e-4 + 1e-4 * k, 2e-4, z, 1.0, 0, 0, 0]]]) for k, z in enumerate(heights)
        ]
        state = initial_state(model, targets[0])
        forces = []
        for target in targets[1:]:
            report = solver.step(state, target)
            assert report.converged.all(), report.summary()
            forces.append(report.contact_force_n[0])
        assert (np.array(forces[: first_contact - 1]) == 0).all() and min(forces[-6:]) > 0
        assert solver.graph.launches == (len(targets) - 2 if capture else 0)
        ends.append(state.positions.numpy())
    np.testing.assert_array_equal(*ends)


@pytest.mark.thorough
def test_lists_that_were_too_short_grow_and_the_step_is_taken_again(eager: np.ndarray) -> None:
    solver, state = make()
    for part in solver.lists:
        part._allocate(2)
    np.testing.assert_array_equal(run(solver, state), eager)
    assert all((part.rooms > 2).any() for part in solver.lists)


@pytest.mark.thorough
def test_lists_that_others_grew_are_not_written_through_old_graphs(eager: np.ndarray) -> None:
    solver, state = make()
    for step in range(1, STEPS):
        assert solver.step(state, poses(step)).converged.all()
        for part in solver.lists:
            part._allocate(part.rooms + 7)
    np.testing.assert_array_equal(
        state.positions.numpy().ravel(), eager[: state.positions.size * 3]
    )


def test_the_plan_says_why_steps_are_not_captured() -> None:
    assert make()[0].plan.is_on("captured graph")
    solver, _ = make(capture=False)
    assert not solver.plan.is_on("captured graph")
    assert "SolverConfig.capture" in solver.plan.describe()
