# SPDX-License-Identifier: Apache-2.0
"""Environments that step each at its own pace end where they end when they step together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.scene import (
    AffineBody,
    KinematicBody,
    Material,
    MaxwellBranch,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    Scene,
    TimeScheme,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import Control, EnvStatus, ReadySteps, SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state
from tests.support.blocks import soft_block
from tests.support.grasps import gel_above_a_table, hand_poses
from tests.support.variants import variants

ENVS, STEPS = 3, 5


def poses(steps: np.ndarray | list[int]) -> np.ndarray:
    """Of the hand that presses the gel on the table and drags it, each environment its own way."""
    return hand_poses(
        (4e-5 * env * step, 1.3e-4 - (3e-5 + 2e-5 * env) * step) for env, step in enumerate(steps)
    )


RELAXING = (MaxwellBranch(0.5, 8e-3), MaxwellBranch(0.2, 0.1))


def make(
    quasi_static: bool,
    scheme: TimeScheme = TimeScheme.EULER,
    branches: tuple[MaxwellBranch, ...] = (),
    **settings: object,
) -> tuple[SolverIPC, State]:
    time = TimeStepping(quasi_static=quasi_static, dt_s=5e-3, scheme=scheme)
    scene = gel_above_a_table(time, ENVS, branches=branches)
    solver = SolverIPC(scene.finalize(), SolverConfig(dhat_m=1e-4, **settings))  # type: ignore[arg-type]
    return solver, initial_state(solver.model, poses([0] * ENVS))


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
    solver, state = make(quasi_static, scheme, branches)
    for step in range(1, STEPS + 1):
        assert solver.step(state, poses([step] * ENVS)).converged.all()
    expected, forces = state.positions.numpy(), solver.contact_gradient.numpy()

    solver, state = make(quasi_static, scheme, branches)
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


def test_a_call_ends_after_its_iterations_and_leaves_alone_what_is_underway() -> None:
    solver, state = make(quasi_static=False)
    ready = ReadySteps(solver, state, 2)
    report = ready.step_ready(poses([3] * ENVS), np.array([True, True, False]))
    assert (report.status[:2] == EnvStatus.RUNNING).all()
    np.testing.assert_array_equal(report.newton_iterations[:2], 2)
    np.testing.assert_array_equal(ready.underway, [True, True, False])
    with pytest.raises(InputError, match="environment 0 has not finished its last step"):
        ready.step_ready(poses([3] * ENVS), np.array([True, False, False]))
    with pytest.raises(InputError, match="in their own step"):
        solver.step(state, poses([3] * ENVS))


@pytest.mark.parametrize("by_reset", [True, False])
def test_a_step_may_be_given_up(by_reset: bool) -> None:
    solver, state = make(quasi_static=False)
    before, start = state.positions.numpy().copy(), state.poses.numpy().copy()
    ready = ReadySteps(solver, state, 2)
    ready.step_ready(poses([3] * ENVS))
    assert ready.underway.all()
    np.testing.assert_array_equal(state.positions.numpy(), before)
    if by_reset:
        solver.reset(state, np.ones(ENVS, dtype=bool), poses([0] * ENVS))
    else:
        ready.drop(np.ones(ENVS, dtype=bool))
    assert not ready.underway.any()
    np.testing.assert_array_equal(state.positions.numpy(), before)
    np.testing.assert_array_equal(state.poses.numpy(), start)
    report = ready.step_ready(poses([1] * ENVS))
    assert (report.newton_iterations <= 2).all(), "it goes on with the step that was given up"
    while ready.underway.any():
        report = ready.step_ready(who=np.zeros(ENVS, dtype=bool))
    fresh, expected = make(quasi_static=False)
    assert fresh.step(expected, poses([1] * ENVS)).converged.all()
    np.testing.assert_array_equal(state.positions.numpy(), expected.positions.numpy())


# Joints, and all that a step may be asked for ----------------------------------------------------


def finger(scheme: TimeScheme = TimeScheme.EULER, **settings: object) -> tuple[SolverIPC, State]:
    """A driven finger on a hinge at a hand presses a gel; a bolt on a slide at the finger runs
    against its limits, so that joints open and close."""
    gel = soft_block(
        (3, 3, 2), (6e-3, 6e-3, 3e-3), Material(1e5, 0.4, branches=RELAXING),
        friction_coefficient=0.3,
    )  # fmt: skip
    at = np.array([-2e-3, 0, 1.1e-3, 0, 0, 0, 1.0])
    above = np.array([-2e-3, 0, 3.5e-3, 0, 0, 0, 1.0])
    scene = Scene(
        gel,
        KinematicBody(None, name="hand"),
        ENVS,
        TimeStepping(quasi_static=False, dt_s=5e-3, scheme=scheme, gravity_m_s2=(0, 0, -9.81)),
        affine_bodies=[
            AffineBody(box_mesh((8e-3, 2e-3, 2e-3)), name="finger", initial_pose=at),
            AffineBody(box_mesh((1e-3, 1e-3, 1e-3)), name="bolt", initial_pose=above),
        ],
        joints=[
            RevoluteJoint(
                "finger", "hand", (-6e-3, 0, 1.1e-3), (0, 1, 0), name="hinge",
                drive=PositionDrive(2e-3, 1e-5),
            ),
            PrismaticJoint(
                "bolt", "finger", (-2e-3, 0, 3.5e-3), (1, 0, 0), name="slide",
                limits_mm=(-0.2, 0.2),
            ),
        ],
    )  # fmt: skip
    solver = SolverIPC(scene.finalize(), SolverConfig(dhat_m=1e-4, **settings))
    return solver, initial_state(solver.model, HAND)


HAND = np.tile([0, 0, 0, 0, 0, 0, 1.0], (ENVS, 1, 1))
DT_S = [0, 5e-3, 4e-3, 6e-3, 5e-3, 3e-3]
"""Of each step."""


def asked(solver: SolverIPC, steps: np.ndarray, dt_s: float | None = None) -> Control:
    """Another request in each step and environment."""
    env = np.arange(ENVS)
    poses = HAND.copy()
    poses[:, 0, 0] = 3e-5 * steps * env
    wrenches = np.zeros((ENVS, 2, 2, 3))
    wrenches[:, 1, 0, 0] = 1e-4 * (-1.0) ** (steps + env)
    forces = np.zeros((ENVS, solver.model.node_count, 3))
    forces[:, solver.model.bodies[0].node_slice, 1] = 1e-5 * (steps * (env + 1))[:, None]
    targets = np.stack([0.05 * steps * (env + 1), 0.0 * env], axis=1)
    return Control(poses, targets, dt_s, forces, wrenches)


def found(solver: SolverIPC, state: State) -> dict[str, np.ndarray]:
    """All that a step leaves behind."""
    joints = solver.joints
    assert joints is not None
    arrays = {name: getattr(state, name) for name in ("positions", "velocities", "poses")}
    names = ("coordinates", "rates", "efforts", "forces", "torques")
    arrays |= {f"joint {name}": getattr(joints, name) for name in names}
    assert state.joints is not None
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
    """Loads, drive targets and lengths of steps are those of an environment's own step, also of
    one that begins anew since its lists of contacts were too ``short``."""
    solver, state = finger(scheme)
    rounds = 0
    for step in range(1, STEPS + 1):
        report = solver.step(state, asked(solver, np.full(ENVS, step), DT_S[step]))
        assert report.converged.all() and (report.substeps == 1).all(), report.describe()
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
    apart = anew = 0
    for _ in range(500):
        free = ~ready.underway & (taken < STEPS)
        step = taken[free].min(initial=STEPS) + 1
        begins = free & (taken + 1 == step)
        control = None
        if begins.any():
            # What is said of the others is not for them.
            control = asked(solver, np.where(begins, step, 9), DT_S[step])
        report = ready.step_ready(control, begins)
        assert (report.converged | np.isin(report.status, UNFINISHED)).all(), report.describe()
        taken += report.converged
        apart = max(apart, np.ptp(taken))
        anew += solver.progress.again.sum()
        if (taken == STEPS).all():
            break
    assert (taken == STEPS).all()
    assert apart > 0, "the paces were meant to differ"
    assert anew > 0 or not short
    for name, array in found(solver, state).items():
        np.testing.assert_array_equal(array, expected[name], err_msg=name)


UNFINISHED = [EnvStatus.RUNNING, EnvStatus.SKIPPED]


def test_targets_of_drives_wait_for_the_next_step() -> None:
    """Those set for environments that begin leave alone what is underway, by a control or not."""
    solver, state = finger()
    assert solver.step(state, asked(solver, np.full(ENVS, 1))).converged.all()
    expected = found(solver, state)

    solver, state = finger()
    assert solver.joints is not None
    ready = ReadySteps(solver, state, 1)
    first = np.array([True, False, False])
    ready.step_ready(asked(solver, np.full(ENVS, 1)), first)
    assert ready.underway[0]
    assert not state.joints.targets.numpy()[1:].any() and not state.wrenches.numpy()[1:].any()
    state.joints.targets.fill_(0.3)
    while ready.underway.any():
        report = ready.step_ready(asked(solver, np.full(ENVS, 4)), ~first & ~ready.underway)
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
        assert solver.step(state, asked(solver, np.full(ENVS, 1))).converged.all()
    assert solver.joints is not None
    before = found(solver, state)
    ready = ReadySteps(solver, state, 1)
    for _ in range(500):
        ready.step_ready(asked(solver, np.full(ENVS, 3)), np.zeros(ENVS, bool) | ~ready.underway)
        if solver.progress.counts.joint_rounds.numpy()[ready.underway].any():
            break
    assert not np.array_equal(solver.joints._step.multipliers.numpy(), before["multipliers"])
    everyone = np.ones(ENVS, dtype=bool)
    if by_reset:
        solver.reset(state, everyone, HAND)
    else:
        ready.drop(everyone)
    after = found(solver, state)
    for name in ("positions", "poses", "multipliers", "joint coordinates"):
        np.testing.assert_array_equal(after[name], before[name], err_msg=name)


def test_a_mechanism_that_fails_is_where_it_began() -> None:
    """With joints that had to be corrected more often than was allowed."""
    solver, state = finger(max_joint_rounds=1)
    ready = ReadySteps(solver, state, 3)
    before = found(solver, state)
    for _ in range(100):
        report = ready.step_ready(asked(solver, np.full(ENVS, 3)), ~ready.underway)
        if (report.status == EnvStatus.JOINT).any():
            break
    failed = report.status == EnvStatus.JOINT
    assert failed.any()
    for name, array in found(solver, state).items():
        if name != "contact":
            np.testing.assert_array_equal(array[failed], before[name][failed], err_msg=name)


def test_a_bad_control_begins_nothing() -> None:
    solver, state = finger()
    with pytest.raises(InputError, match="iterations must be at least 1, got 0"):
        ReadySteps(solver, state, 0)
    ready = ReadySteps(solver, state)
    good = asked(solver, np.full(ENVS, 1))
    with pytest.raises(InputError, match="wrenches holds NaN"):
        ready.step_ready(replace(good, wrenches=np.full((ENVS, 2, 2, 3), np.nan)))
    assert not ready.underway.any()
    assert state.joints is not None and not state.joints.targets.numpy().any()
    assert state.wrenches is None
