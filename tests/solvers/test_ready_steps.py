# SPDX-License-Identifier: Apache-2.0
"""Environments that step each at its own pace end where they end when they step together."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import (
    AffineBody,
    Element,
    KinematicBody,
    Material,
    RevoluteJoint,
    Scene,
    SoftBody,
    TimeScheme,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import EnvStatus, ReadySteps, SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state

ENVS, STEPS = 3, 5


def poses(steps: np.ndarray | list[int]) -> np.ndarray:
    """Of the hand that presses the gel on the table and drags it, each environment its own way."""
    rows = []
    for env, step in enumerate(steps):
        x, z = 4e-5 * env * step, 1.3e-4 - (3e-5 + 2e-5 * env) * step
        rows.append([[x, 0, z, 1, 0, 0, 0], [0, 0, -2e-3, 0, 0, 0, 1]])
    return np.array(rows)


def make(
    quasi_static: bool, scheme: TimeScheme = TimeScheme.EULER, **settings: object
) -> tuple[SolverIPC, State]:
    gel = SoftBody(
        block_mesh((3, 3, 2), (6e-3, 6e-3, 3e-3)),
        Material(1e5, 0.4, damping_time_s=0.0 if quasi_static else 1e-3),
        mount="hand",
        friction_coefficient=0.3,
        element=Element.LINEAR,
    )
    table = KinematicBody(box_mesh((60e-3, 60e-3, 4e-3)), 0.3, name="table")
    time = TimeStepping(quasi_static=quasi_static, dt_s=5e-3, scheme=scheme)
    scene = Scene([gel], [KinematicBody(None, name="hand"), table], ENVS, time)
    solver = SolverIPC(scene.finalize(), SolverConfig(dhat_m=1e-4, **settings))
    return solver, initial_state(solver.model, poses([0] * ENVS))


@pytest.mark.parametrize("iterations", [1, 3])
@pytest.mark.parametrize(
    ("quasi_static", "scheme"),
    [(True, TimeScheme.EULER), (False, TimeScheme.EULER), (False, TimeScheme.BDF2)],
)
def test_the_pace_of_an_environment_changes_no_bit(
    quasi_static: bool, scheme: TimeScheme, iterations: int
) -> None:
    """Of BDF2, too, which meets an impact here and begins that step anew."""
    solver, state = make(quasi_static, scheme)
    for step in range(1, STEPS + 1):
        assert solver.step(state, poses([step] * ENVS)).converged.all()
    expected, forces = state.positions.numpy(), solver.contact_gradient.numpy()

    solver, state = make(quasi_static, scheme)
    ready = ReadySteps(solver, state, iterations)
    taken, calls = np.zeros(ENVS, dtype=int), 0
    while (taken < STEPS).any():
        begins = ~ready.underway & (taken < STEPS)
        report = ready.step_ready(poses(taken + 1), begins)
        over = report.status != EnvStatus.RUNNING
        assert (report.converged | ~over | (report.status == EnvStatus.SKIPPED)).all()
        taken += report.converged
        calls += 1
        assert calls < 500
    assert len(set(report.newton_iterations)) > 1 or calls > STEPS, "paces differ"
    np.testing.assert_array_equal(state.positions.numpy(), expected)
    np.testing.assert_array_equal(solver.contact_gradient.numpy(), forces)


def test_a_call_ends_after_its_iterations() -> None:
    solver, state = make(quasi_static=False)
    ready = ReadySteps(solver, state, 2)
    report = ready.step_ready(poses([3] * ENVS))
    assert (report.status == EnvStatus.RUNNING).all()
    np.testing.assert_array_equal(report.newton_iterations, 2)
    assert ready.underway.all()


def test_what_is_underway_is_left_alone() -> None:
    solver, state = make(quasi_static=False)
    ready = ReadySteps(solver, state, 1)
    ready.step_ready(poses([3] * ENVS), np.array([True, False, False]))
    with pytest.raises(InputError, match="environment 0 has not finished its last step"):
        ready.step_ready(poses([3] * ENVS), np.array([True, False, False]))
    with pytest.raises(InputError, match="in a step of their own"):
        solver.step(state, poses([3] * ENVS))


@pytest.mark.parametrize("by_reset", [True, False])
def test_a_step_may_be_given_up(by_reset: bool) -> None:
    solver, state = make(quasi_static=False)
    before, start = state.positions.numpy().copy(), state.poses.numpy().copy()
    ready = ReadySteps(solver, state, 2)
    ready.step_ready(poses([3] * ENVS))
    assert not np.array_equal(state.positions.numpy(), before)
    if by_reset:
        solver.reset(state, np.ones(ENVS, dtype=bool), poses([0] * ENVS))
    else:
        ready.drop(np.ones(ENVS, dtype=bool))
    assert not ready.underway.any()
    np.testing.assert_array_equal(state.positions.numpy(), before)
    np.testing.assert_array_equal(state.poses.numpy(), start)
    assert solver.step(state, poses([1] * ENVS)).converged.all()


def test_lists_that_are_too_short_grow_and_the_step_begins_anew() -> None:
    solver, state = make(quasi_static=False)
    for step in range(1, STEPS + 1):
        solver.step(state, poses([step] * ENVS))
    expected = state.positions.numpy()

    solver, state = make(quasi_static=False)
    for part in solver.lists:
        part._allocate(2)
    ready = ReadySteps(solver, state)
    taken = np.zeros(ENVS, dtype=int)
    for _ in range(300):
        report = ready.step_ready(poses(taken + 1), ~ready.underway & (taken < STEPS))
        taken += report.converged
    assert (taken == STEPS).all()
    np.testing.assert_allclose(state.positions.numpy(), expected, atol=1e-12)


def test_what_fails_is_where_it_began() -> None:
    solver, state = make(quasi_static=False, max_newton_iterations=2)
    before = state.positions.numpy().copy()
    ready = ReadySteps(solver, state, 5)
    report = ready.step_ready(poses([4] * ENVS))
    assert (report.status == EnvStatus.NO_CONVERGENCE).all()
    assert not ready.underway.any()
    np.testing.assert_array_equal(state.positions.numpy(), before)


def test_settings_are_checked() -> None:
    solver, state = make(quasi_static=False)
    with pytest.raises(InputError, match="iterations must be at least 1, got 0"):
        ReadySteps(solver, state, 0)
    joint = RevoluteJoint("box", "hand", (0, 0, 0), name="hinge")
    box = AffineBody(box_mesh((1e-3, 1e-3, 1e-3)), name="box")
    hand, time = KinematicBody(None, name="hand"), TimeStepping(quasi_static=False)
    scene = Scene(kinematic_bodies=[hand], affine_bodies=[box], joints=[joint], time=time)
    jointed = SolverIPC(scene.finalize())
    with pytest.raises(InputError, match="scenes with joints are stepped together"):
        ReadySteps(jointed, initial_state(jointed.model))
