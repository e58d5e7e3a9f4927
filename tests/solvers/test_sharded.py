# SPDX-License-Identifier: Apache-2.0
"""Environments spread over shards do what they do together, bit by bit on the CPU."""

from __future__ import annotations

import threading
from dataclasses import fields

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    KinematicBody,
    Material,
    Plane,
    PositionDrive,
    RevoluteJoint,
    Scene,
    SoftBody,
    Surface,
    TimeStepping,
    box_mesh,
)
from taccel_lab.scene.shards import shard_of, shard_slice
from taccel_lab.solvers import EnvStatus, ShardedSolver, SolverConfig, SolverIPC, StepReport
from taccel_lab.state import State, initial_state
from tests.support.blocks import pose

ENVS = 5
CELLS, SIZE = (3, 3, 2), (3e-3, 3e-3, 2e-3)
MESH = block_mesh(CELLS, SIZE, jitter=0.1)
RESTS = np.stack([block_mesh(CELLS, SIZE, jitter=0.1, seed=s).nodes_m for s in range(ENVS)])
SIDE = 1.2e-3
FLAP = (2e-3, 3e-4, 1e-3)
CONFIG = SolverConfig(relative_tolerance=1e-6, max_newton_iterations=60, max_substep_halvings=1)
START_Z, FAILS = 1.05e-3, 3
FAST = 0.02
"""Way of the object in environment FAILS in the step that it cannot take [m]."""


def scene_of(joint: bool = False) -> Scene:
    """A ball or a block is pressed into a gel of other shape in each environment, beside a cube
    that falls and a flap, which a drive may turn."""
    falling = np.stack(
        [pose(4e-3, 0, SIDE / 2 - 2.5e-3 + 2e-5 + 2e-6 * e, (0, 0, 1), 9.0 * e) for e in range(5)]
    )
    where = np.stack([pose(-5e-3, 1e-4 * e, 0.0) for e in range(ENVS)])
    hinge = RevoluteJoint(
        "flap",
        anchor_m=where[:, :3] + [1e-3, 0, 0],
        axis=np.stack([[0.1 * e, 1, 0.2] for e in range(ENVS)]),
        drive=PositionDrive(1e-5, 1e-8, target=0.02 * np.arange(ENVS)),
    )
    return Scene(
        SoftBody(
            MESH,
            Material(1e5, 0.4),
            rest_positions_m=RESTS,
            friction_coefficient=0.4,
            element=Element.LINEAR,
        ),
        [
            KinematicBody(Ball(1e-3), 0.5, "ball", Surface(environments=(0, 1, 3))),
            KinematicBody(box_mesh((2e-3,) * 3), 0.5, "block", Surface(environments=(2, 4))),
        ],
        ENVS,
        TimeStepping(False, 2e-3, (0, 0, -9.81)),
        affine_bodies=[
            AffineBody(
                box_mesh((SIDE,) * 3),
                8000,
                friction_coefficient=0.4,
                name="cube",
                initial_pose=falling,
                surface=Surface(environments=(0, 1, 2, 4)),
            ),
            AffineBody(box_mesh(FLAP), 2000, name="flap", initial_pose=where),
        ],
        planes=Plane((0, 0, -2.5e-3), name="floor"),
        joints=[hinge] if joint else [],
    )


def targets(step: int) -> np.ndarray:
    """Both objects at the same place, each environment elsewhere; [env, 2, 7]."""
    rows = []
    for env in range(ENVS):
        z = START_Z - (4e-5 + 5e-6 * env) * step
        rows.append([pose(1e-4 * env, 1e-5 * env * step, z, (0, 1, 2), 0.5 * env * step)] * 2)
    return np.array(rows)


def too_far(step: int) -> np.ndarray:
    """The same, but environment FAILS is asked for what it cannot do."""
    moved = targets(step)
    moved[FAILS, :, 2] -= FAST
    return moved


def arrays(solver: SolverIPC, state: State) -> list[np.ndarray]:
    return [
        array.numpy().copy()
        for array in (
            state.positions,
            state.velocities,
            state.poses,
            solver.contact_gradient,
            solver.friction_gradient,
        )
    ]


def sharded_arrays(solver: ShardedSolver) -> list[np.ndarray]:
    parts = [arrays(shard.solver, shard.state) for shard in solver.shards]
    return [np.concatenate(found) for found in zip(*parts, strict=True)]


def assert_same_reports(one: StepReport, other: StepReport) -> None:
    for field in fields(StepReport):
        if field.name != "seconds":
            mine, theirs = getattr(one, field.name), getattr(other, field.name)
            np.testing.assert_array_equal(mine, theirs, err_msg=field.name)


MASK = np.array([False, True, False, True, False])
MOTION = [(targets, 1), (targets, 2), (too_far, 3), (targets, 4)]


Steps = list[tuple[StepReport, list[np.ndarray]]]


@pytest.fixture(scope="module", params=[False, True], ids=["free", "joint"])
def joint(request: pytest.FixtureRequest) -> bool:
    return request.param


@pytest.fixture(scope="module")
def together(joint: bool) -> Steps:
    """Reports and arrays after each step of the motion; a reset is before the last one."""
    model = scene_of(joint).finalize("cpu")
    solver = SolverIPC(model, CONFIG)
    state = initial_state(model, targets(0))
    found = []
    for make, step in MOTION:
        if step == 4:
            solver.reset(state, MASK, targets(0))
        found.append((solver.step(state, make(step)), arrays(solver, state)))
    return found


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_shards_give_the_bits_of_one_solver(together: Steps, joint: bool, count: int) -> None:
    sharded = ShardedSolver(scene_of(joint), ["cpu"] * count, CONFIG, targets(0))
    assert [s.model.env_count for s in sharded.shards] == {
        1: [5],
        2: [3, 2],
        3: [2, 2, 1],
        5: [1] * 5,
    }[count]
    for (make, step), (expected, values) in zip(MOTION, together, strict=True):
        if step == 4:
            sharded.reset(MASK, targets(0))
        report = sharded.step(make(step))
        assert_same_reports(report, expected)
        for mine, theirs in zip(sharded_arrays(sharded), values, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(sharded.positions(), together[-1][1][0])


def test_the_motion_shows_what_it_is_meant_to(together: Steps) -> None:
    """Contact, differing environments, one failure, and a reset that goes back."""
    first, second, third, fourth = (report for report, _ in together)
    assert first.converged.all() and second.converged.all() and fourth.converged.all()
    assert list(third.failures().values()) == [[FAILS]]
    assert (second.contact_force_n > 1e-4).all()
    assert len(np.unique(second.residual_n)) == ENVS
    moved = together[3][1][0] - together[2][1][0]
    soft = np.abs(moved[:, : MESH.node_count]).max(axis=(1, 2))
    assert (soft > 1e-6).all()
    rolled_back = together[2][1][0][FAILS] - together[1][1][0][FAILS]
    assert not rolled_back.any()


def test_the_size_of_a_mounted_gel_does_not_matter_elsewhere() -> None:
    """How far its mount may turn at once depends on it."""
    rests = np.stack([RESTS[0], 1.4 * RESTS[1], RESTS[2]])

    def poses(step: int) -> np.ndarray:
        turned = pose(0, 0, 0, (0, 1, 0.3), 20.0 * step)
        rows = [[turned, pose(1e-4 * e, 0, 1.02e-3 - 4e-5 * step)] for e in range(len(rests))]
        return np.array(rows)

    scene = Scene(
        SoftBody(
            MESH,
            Material(1e5, 0.4),
            rest_positions_m=rests,
            mount="mount",
            friction_coefficient=0.5,
            element=Element.LINEAR,
        ),
        [KinematicBody(None, name="mount"), KinematicBody(Ball(1e-3), 0.5)],
        len(rests),
    )
    one = ShardedSolver(scene, ["cpu"], poses=poses(0))
    three = ShardedSolver(scene, ["cpu"] * 3, poses=poses(0))
    for step in (1, 2):
        report = one.step(poses(step))
        assert report.converged.all()
        assert_same_reports(three.step(poses(step)), report)
    np.testing.assert_array_equal(three.positions(), one.positions())


def test_processes_need_only_their_part() -> None:
    """What a process of rank 1 of 2 does, without the other one."""
    rank, world = 1, 2
    part = shard_slice(ENVS, rank, world)
    model = shard_of(scene_of(), rank, world).finalize("cpu")
    solver = SolverIPC(model, CONFIG)
    state = initial_state(model, targets(0)[part])
    report = solver.step(state, targets(1)[part])
    sharded = ShardedSolver(scene_of(), ["cpu", "cpu"], CONFIG, targets(0))
    whole = sharded.step(targets(1))
    np.testing.assert_array_equal(whole.residual_n[part], report.residual_n)
    np.testing.assert_array_equal(sharded.positions()[part], state.positions.numpy())


def test_objects_stay_without_targets_and_resets_keep_poses() -> None:
    sharded = ShardedSolver(scene_of(), ["cpu"] * 2, CONFIG, targets(0))
    sharded.step(targets(1))
    sharded.step()
    poses = sharded.gather(lambda shard: shard.state.poses).reshape(ENVS, 2, 7)
    np.testing.assert_allclose(poses, targets(1), atol=1e-12)
    sharded.reset(MASK)
    np.testing.assert_array_equal(
        sharded.gather(lambda shard: shard.state.poses).reshape(ENVS, 2, 7), poses
    )
    forces = sharded.gather(lambda shard: np.arange(shard.model.env_count) + 10)
    assert forces.tolist() == [10, 11, 12, 10, 11]


def test_a_shard_has_its_turn_while_another_one_waits_for_its_device(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Both are waiting at the same time: so both have been launched before either was read."""
    sharded = ShardedSolver(scene_of(), ["cpu"] * 2, CONFIG, targets(0))
    meeting = threading.Barrier(2, timeout=60)
    main = threading.get_ident()

    def wait(_: object) -> None:
        assert threading.get_ident() != main
        meeting.wait()

    monkeypatch.setattr("taccel_lab.solvers.sharded.wp.synchronize_stream", wait)
    assert sharded.step(targets(1)).converged.all()
    assert meeting.n_waiting == 0 and not meeting.broken


def test_an_error_in_a_shard_is_raised_and_the_others_end_their_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sharded = ShardedSolver(scene_of(), ["cpu"] * 3, CONFIG, targets(0))
    before = sharded.positions()

    def broken(*_: object) -> StepReport:
        raise MemoryError("no room on the device")

    monkeypatch.setattr(sharded.shards[1].solver, "step", broken)
    with pytest.raises(MemoryError, match="no room"):
        sharded.step(targets(1))
    moved = np.abs(sharded.positions() - before).max(axis=(1, 2)) > 0
    assert moved.tolist() == [True, True, False, False, True]
    monkeypatch.undo()
    assert sharded.shards[1].solver.step(sharded.states[1]).converged.all()


def test_a_solver_of_a_shard_can_be_stepped_alone() -> None:
    sharded = ShardedSolver(scene_of(), ["cpu"] * 2, CONFIG, targets(0))
    shard = sharded.shards[0]
    report = shard.solver.step(shard.state, targets(1)[shard.environments])
    assert report.status.tolist() == [EnvStatus.CONVERGED] * 3


def test_bad_input_is_refused_before_anything_moves() -> None:
    scene = scene_of()
    with pytest.raises(InputError, match="5 environments can be spread over 1 to 5 devices, got 6"):
        ShardedSolver(scene, ["cpu"] * 6)
    with pytest.raises(InputError, match="got 0: none"):
        ShardedSolver(scene, [])
    with pytest.raises(InputError, match="device 'cuda:99' is not there; this machine has: cpu"):
        ShardedSolver(scene, ["cpu", "cuda:99"])
    with pytest.raises(InputError, match=r"poses have shape \(4, 2, 7\), expected \(5, 2, 7\)"):
        ShardedSolver(scene, ["cpu"], poses=targets(0)[:4])
    sharded = ShardedSolver(scene, ["cpu"] * 2, CONFIG, targets(0))
    before = sharded.positions()
    bad = targets(1)
    bad[4, 0, 1] = np.nan
    with pytest.raises(InputError, match="NaN"):
        sharded.step(bad)
    with pytest.raises(InputError, match=r"expected \(5, 2, 7\)"):
        sharded.step(targets(1)[:3])
    for mask in (MASK[:4], MASK.astype(int), np.array([1, 3])):
        with pytest.raises(InputError, match=r"mask must be bool of shape \[5\]"):
            sharded.reset(mask)
    np.testing.assert_array_equal(sharded.positions(), before)
