# SPDX-License-Identifier: Apache-2.0
"""Environments that step each at its own pace end where they end when they step together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.errors import InputError
from taccel_lab.scene import MaxwellBranch, TimeScheme
from taccel_lab.solvers import EnvStatus, ReadySteps, SolverIPC
from taccel_lab.state import State, initial_state
from tests.solvers.steps import (
    DT_S,
    ENVS,
    EVERYONE,
    HAND,
    RELAXING,
    asked,
    finger,
    poses,
    pressed,
    stepped,
)
from tests.support.variants import variants

STEPS = 5
UNFINISHED = [EnvStatus.RUNNING, EnvStatus.SKIPPED]


@pytest.mark.parametrize("iterations", [1, 3])
@pytest.mark.parametrize(
    ("quasi_static", "scheme", "branches"),
    [
        (True, TimeScheme.EULER, ()),
        (True, TimeScheme.EULER, RELAXING),
        (False, TimeScheme.EULER, ()),
        (False, TimeScheme.BDF2, ()),
    ],
)
def test_the_pace_of_an_environment_changes_no_bit(
    quasi_static: bool, scheme: TimeScheme, branches: tuple[MaxwellBranch, ...], iterations: int
) -> None:
    """Of BDF2, too, which meets an impact here and begins that step anew."""
    solver, state = pressed(quasi_static, scheme, branches)
    for step in range(1, STEPS + 1):
        stepped(solver, state, poses(step))
    expected, forces = state.positions.numpy(), solver.contact_gradient.numpy()

    solver, state = pressed(quasi_static, scheme, branches)
    ready = ReadySteps(solver, state, iterations)
    taken, calls = np.zeros(ENVS, dtype=int), 0
    while (taken < STEPS).any():
        report = ready.step_ready(poses(taken + 1), ~ready.underway & (taken < STEPS))
        assert (report.converged | np.isin(report.status, UNFINISHED)).all()
        taken += report.converged
        calls += 1
        assert calls < 500
    assert len(set(report.newton_iterations)) > 1 or calls > STEPS, "paces differ"
    np.testing.assert_array_equal(state.positions.numpy(), expected)
    np.testing.assert_array_equal(solver.contact_gradient.numpy(), forces)


def test_a_line_search_that_lasts_beyond_a_call_changes_no_bit() -> None:
    """Of pegs that are pushed in by strides of four steps: their line searches are cut."""
    bench = build_scene("peg", SceneOptions(3, "generated", {}))
    model = bench.scene.finalize("cpu")
    moves = (np.ptp(bench.path, axis=0) > 0).any(axis=1)
    offsets = np.random.default_rng(0).uniform(-1e-4, 1e-4, (30, 3, int(moves.sum()), 3))

    def targets(taken: np.ndarray) -> np.ndarray:
        found = bench.path[4 * (taken + 1)].copy()
        found[:, moves, :3] += offsets[taken, np.arange(3)]
        return found

    solver, state = SolverIPC(model, bench.config), initial_state(model, bench.targets(0))
    for step in range(30):
        assert solver.step(state, targets(np.full(3, step))).converged.all()
    expected = state.positions.numpy()

    solver, state = SolverIPC(model, bench.config), initial_state(model, bench.targets(0))
    ready = ReadySteps(solver, state, 1)
    taken, searching = np.zeros(3, dtype=int), 0
    while (taken < 30).any():
        report = ready.step_ready(targets(np.minimum(taken, 29)), ~ready.underway & (taken < 30))
        searching += int(solver.progress.phases.searching.numpy().sum())
        taken += report.converged
    assert searching > 10
    np.testing.assert_array_equal(state.positions.numpy(), expected)


def test_a_call_ends_after_its_iterations_and_leaves_alone_what_is_underway() -> None:
    solver, state = pressed(quasi_static=False)
    ready = ReadySteps(solver, state, 2)
    report = ready.step_ready(poses(3), np.array([True, True, False]))
    assert (report.status[:2] == EnvStatus.RUNNING).all()
    np.testing.assert_array_equal(report.newton_iterations[:2], 2)
    np.testing.assert_array_equal(ready.underway, [True, True, False])
    with pytest.raises(InputError, match="environment 0 has not finished its last step"):
        ready.step_ready(poses(3), np.array([True, False, False]))
    with pytest.raises(InputError, match="in their own step"):
        solver.step(state, poses(3))


def give_up(ready: ReadySteps, start: np.ndarray | None) -> None:
    """All steps underway, by a reset to poses or by dropping them."""
    if start is None:
        ready.drop(EVERYONE)
    else:
        ready.solver.reset(ready.state, EVERYONE, start)
    assert not ready.underway.any()


@pytest.mark.parametrize("by_reset", [True, False])
def test_a_step_may_be_given_up(by_reset: bool) -> None:
    solver, state = pressed(quasi_static=False)
    before, start = state.positions.numpy().copy(), state.poses.numpy().copy()
    ready = ReadySteps(solver, state, 2)
    ready.step_ready(poses(3))
    assert ready.underway.all()
    np.testing.assert_array_equal(state.positions.numpy(), before)
    give_up(ready, poses(0) if by_reset else None)
    np.testing.assert_array_equal(state.positions.numpy(), before)
    np.testing.assert_array_equal(state.poses.numpy(), start)
    report = ready.step_ready(poses(1))
    assert (report.newton_iterations <= 2).all(), "it goes on with the step that was given up"
    while ready.underway.any():
        report = ready.step_ready(who=~EVERYONE)
    fresh, expected = pressed(quasi_static=False)
    stepped(fresh, expected, poses(1))
    np.testing.assert_array_equal(state.positions.numpy(), expected.positions.numpy())


# Joints, and all that a step may be asked for ----------------------------------------------------


def found(solver: SolverIPC, state: State) -> dict[str, np.ndarray]:
    joints = solver.joints
    assert joints is not None and state.joints is not None
    arrays = {name: getattr(state, name) for name in ("positions", "velocities", "poses")}
    names = ("coordinates", "rates", "efforts", "forces", "torques")
    arrays |= {f"joint {name}": getattr(joints, name) for name in names}
    arrays |= {"multipliers": state.joints.multipliers, "contact": solver.contact_gradient}
    return {name: array.numpy().copy() for name, array in arrays.items()}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("scheme", "iterations", "short"),
    variants(
        [(TimeScheme.BDF2, 1, True), (TimeScheme.EULER, 3, False)],
        TimeScheme, [1, 3], [False, True],
    ),
)  # fmt: skip
def test_joints_and_controls_know_no_pace(scheme: TimeScheme, iterations: int, short: bool) -> None:
    """Loads, targets and lengths of steps are those of its own step, also where it begins anew."""
    solver, state = finger(scheme)
    rounds = 0
    for step in range(1, STEPS + 1):
        report = stepped(solver, state, asked(solver, step, DT_S[step]))
        assert (report.substeps == 1).all(), report.describe()
        rounds += solver.progress.counts.joint_rounds.numpy().sum()
    expected = found(solver, state)
    assert rounds > 0, "joints were meant to open"
    assert np.ptp(expected["joint coordinates"], axis=0).min() > 1e-6
    assert np.abs(expected["contact"]).max(axis=(1, 2)).min() > 1e-3

    solver, state = finger(scheme)
    for part in solver.lists if short else []:
        part._allocate(1)
    ready = ReadySteps(solver, state, iterations)
    taken = np.zeros(ENVS, dtype=int)
    calls = apart = anew = 0
    while (taken < STEPS).any():
        free = ~ready.underway & (taken < STEPS)
        step = taken[free].min(initial=STEPS) + 1
        begins = free & (taken + 1 == step)
        # What is said of the others is not for them.
        control = asked(solver, np.where(begins, step, 9), DT_S[step]) if begins.any() else None
        report = ready.step_ready(control, begins)
        assert (report.converged | np.isin(report.status, UNFINISHED)).all(), report.describe()
        taken += report.converged
        apart = max(apart, np.ptp(taken))
        anew += solver.progress.again.sum()
        calls += 1
        assert calls < 500
    assert apart > 0, "the paces were meant to differ"
    assert anew > 0 or not short
    for name, array in found(solver, state).items():
        np.testing.assert_array_equal(array, expected[name], err_msg=name)


def test_targets_of_drives_wait_for_the_next_step() -> None:
    """Those set for environments that begin leave alone what is underway, by a control or not."""
    solver, state = finger()
    stepped(solver, state, asked(solver, 1))
    expected = found(solver, state)

    solver, state = finger()
    assert state.joints is not None
    ready = ReadySteps(solver, state, 1)
    first = np.array([True, False, False])
    ready.step_ready(asked(solver, 1), first)
    assert ready.underway[0]
    assert not state.joints.targets.numpy()[1:].any() and not state.wrenches.numpy()[1:].any()
    state.joints.targets.fill_(0.3)
    while ready.underway.any():
        report = ready.step_ready(asked(solver, 4), ~first & ~ready.underway)
        if report.converged[0]:
            break
    assert report.converged[0]
    ready.drop(~first)
    for name, array in found(solver, state).items():
        np.testing.assert_array_equal(array[0], expected[name][0], err_msg=name)


@pytest.mark.parametrize("by_reset", [True, False])
def test_a_mechanism_whose_step_is_given_up_is_where_it_began(by_reset: bool) -> None:
    solver, state = finger()
    if not by_reset:
        stepped(solver, state, asked(solver, 1))
    assert solver.joints is not None
    before = found(solver, state)
    ready = ReadySteps(solver, state, 1)
    for _ in range(500):
        ready.step_ready(asked(solver, 3), ~ready.underway)
        if solver.progress.counts.joint_rounds.numpy()[ready.underway].any():
            break
    assert not np.array_equal(solver.joints._step.multipliers.numpy(), before["multipliers"])
    give_up(ready, HAND if by_reset else None)
    after = found(solver, state)
    for name in ("positions", "poses", "multipliers", "joint coordinates"):
        np.testing.assert_array_equal(after[name], before[name], err_msg=name)


def test_a_mechanism_that_fails_is_where_it_began() -> None:
    """With joints that had to be corrected more often than was allowed."""
    solver, state = finger(max_joint_rounds=1)
    ready = ReadySteps(solver, state, 3)
    before = found(solver, state)
    for _ in range(100):
        failed = ready.step_ready(asked(solver, 3), ~ready.underway).status == EnvStatus.JOINT
        if failed.any():
            break
    assert failed.any()
    for name, array in found(solver, state).items():
        if name != "contact":
            np.testing.assert_array_equal(array[failed], before[name][failed], err_msg=name)


def test_a_bad_control_begins_nothing() -> None:
    solver, state = finger()
    with pytest.raises(InputError, match="iterations must be at least 1, got 0"):
        ReadySteps(solver, state, 0)
    ready = ReadySteps(solver, state)
    wrenches = np.full((ENVS, 2, 2, 3), np.nan)
    with pytest.raises(InputError, match="wrenches holds NaN"):
        ready.step_ready(replace(asked(solver, 1), wrenches=wrenches))
    assert not ready.underway.any()
    assert state.joints is not None and not state.joints.targets.numpy().any()
    assert state.wrenches is None
