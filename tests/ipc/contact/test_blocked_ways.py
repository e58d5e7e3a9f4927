# SPDX-License-Identifier: Apache-2.0
"""Ways of tools through bonded faces are found where a step fails, and no others are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.contact.blocked_ways import BlockedWays
from taccel_lab.model import Model
from taccel_lab.scene import Ball, KinematicBody, Scene, TimeStepping, box_mesh, cylinder_mesh
from taccel_lab.solvers import EnvStatus, ReadySteps, SolverIPC
from taccel_lab.state import initial_state
from tests.support import blocks
from tests.support.blocks import soft_block

CELLS, SIZE_M = (4, 4, 2), (8e-3, 8e-3, 4e-3)
BALL = Ball(2e-3)
PIN = cylinder_mesh(0.5e-3, 6e-3)
BAR = box_mesh((12e-3, 2e-3, 1e-3))


def pose(x: float, y: float, z: float, tilt_deg: float = 0.0) -> np.ndarray:
    """Of one environment and body, lengths in mm, tilted about y; [1, 1, 7]."""
    return blocks.pose(1e-3 * x, 1e-3 * y, 1e-3 * z, (0, 1, 0), tilt_deg)[None, None]


def model(shape: Any = BALL, envs: int = 1, mount: str | None = None, **options: Any) -> Model:
    bodies = [KinematicBody(shape, name="tool"), KinematicBody(None, name="mount")]
    gel = soft_block(CELLS, SIZE_M, name="gel", mount=mount, **options)
    return Scene(gel, bodies[: 1 if mount is None else 2], envs).finalize("cpu")


@pytest.mark.parametrize(
    ("shape", "start", "end", "blocked"),
    [
        (BALL, pose(0, 0, 100), pose(0, 0, 1), False),
        (BALL, pose(100, 0, 1), pose(0, 0, 1), False),
        (BALL, pose(0, 0, 1), pose(500, 0, 1), False),
        (BALL, pose(0, 0, 2.1), pose(0, 0, -1.5), False),
        (BALL, pose(0, 0, 2.1), pose(0, 0, -2.5), True),
        (BALL, pose(0, 0, 2.1), pose(0, 0, -500), True),
        (BALL, pose(7, 0, -3), pose(0, 0, -3), True),
        (BALL, pose(9, 0, 50), pose(9, 0, -50), False),
        (PIN, pose(0, 0, 3.1), pose(0, 0, -0.9), False),
        (PIN, pose(0, 0, 3.1), pose(0, 0, -1.2), True),
        (PIN, pose(0, 0, 3.1), pose(0, 0, -500), True),
        # The middle of a wide tool is far above, its rim is not; and the whole gel in a box.
        (BAR, pose(0, 0, 2), pose(0, 0, 0, 30), False),
        (BAR, pose(0, 0, 2), pose(0, 0, -1.5, 30), True),
        (box_mesh((20e-3, 20e-3, 20e-3)), pose(0, 0, 11), pose(0, 0, 1), True),
    ],
)
def test_only_ways_through_what_is_held_are_blocked(
    shape: Any, start: np.ndarray, end: np.ndarray, blocked: bool
) -> None:
    found = BlockedWays(model(shape)).find(start, end, np.ones(1, dtype=bool))
    assert list(found) == ([0] if blocked else [])


def test_a_step_is_refused_and_the_others_go_on() -> None:
    """Took 102 iterations a part and up to 2,000 in all, and ended at 6e9 N."""
    solver, start = SolverIPC(model(envs=3)), np.tile(pose(0, 0, 2.1), (3, 1, 1))
    state = initial_state(solver.model, start)
    target = np.concatenate([pose(0, 0, 1.8), pose(0, 0, -500), pose(0, 0, 1.9)])
    before = state.positions.numpy().copy()
    report = solver.step(state, target)
    good, bad = EnvStatus.CONVERGED, EnvStatus.BLOCKED
    assert report.status.tolist() == [good, bad, good]
    assert report.newton_iterations[1] < 300 and report.substeps[1] == 0
    after = state.positions.numpy()
    assert np.array_equal(after[1], before[1]) and not np.array_equal(after[0], before[0])
    assert report.failures() == {"BLOCKED": [1]}
    words = solver.ways.of_step(state, solver.end_poses, ~report.converged)[1].words()
    for part in ("a step of 502.1 mm", "'tool'", "'gel', 4 mm thick", "held", "shorter dt"):
        assert part in words
    # The next step is one like any other.
    assert solver.step(state, start).converged.all()


def test_what_is_held_moves_with_its_mount() -> None:
    ways = BlockedWays(model(mount="mount"))
    one = np.ones(1, dtype=bool)
    start = np.concatenate([pose(0, 0, 2.1), pose(0, 0, 0)], axis=1)
    along = np.concatenate([pose(0, 0, -497.9), pose(0, 0, -500)], axis=1)
    towards = np.concatenate([pose(0, 0, 2.1), pose(0, 0, 5)], axis=1)
    assert ways and not ways.find(start, along, one)
    assert list(ways.find(start, towards, one)) == [0]


def test_a_gel_is_held_where_it_was_put() -> None:
    aside = np.stack([pose(0, 0, 50)[0, 0], pose(0, 0, 0, 180)[0, 0]])
    ways = BlockedWays(model(envs=2, initial_pose=aside))
    two = np.ones(2, dtype=bool)
    for start, end, blocked in ((52.1, 43, 0), (-2.1, 3, 1)):
        poses = [np.tile(pose(0, 0, z), (2, 1, 1)) for z in (start, end)]
        assert list(ways.find(poses[0], poses[1], two)) == [blocked]


def test_a_scene_without_held_gels_has_nothing_to_look_at() -> None:
    free = soft_block(CELLS, SIZE_M, bonded_nodes=np.zeros(0, dtype=np.int64))
    falling, tool = TimeStepping(quasi_static=False), KinematicBody(Ball(1e-3))
    for scene in (Scene(free, tool, time=falling), Scene(soft_block(CELLS, SIZE_M))):
        assert not BlockedWays(scene.finalize("cpu"))


def test_steps_that_converge_look_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looking took 1.1 ms of a step of 2.1 on a GPU, which was read and waited for."""
    solver = SolverIPC(model())
    state = initial_state(solver.model, pose(0, 0, 2.1))
    steps = ReadySteps(solver, state, iterations=500)
    with monkeypatch.context() as patch:
        patch.setattr(BlockedWays, "find", None)
        assert solver.step(state, pose(0, 0, 1.9)).converged.all()
        assert steps.step_ready(pose(0, 0, 1.8)).converged.all()
    # Targets on a device count as those of the host, and steps at their own pace as the others.
    there = wp.array(pose(0, 0, -9).reshape(1, 1, 7), dtype=wp.transformd, device="cpu")
    assert solver.step(state, there).status.tolist() == [EnvStatus.BLOCKED]
    assert steps.step_ready(pose(0, 0, -9)).status.tolist() == [EnvStatus.BLOCKED]
    assert not steps.underway.any()
