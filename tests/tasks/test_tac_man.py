# SPDX-License-Identifier: Apache-2.0
"""Execution and recovery: the fit of markers, what mechanisms need, and a hinge that turns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.tasks.catalogue import FILES, named, read_task
from taccel_lab.tasks.run import run_task
from taccel_lab.tasks.tac_man import TacManParameters, rigid_fit


def test_a_fit_gives_back_the_motion() -> None:
    """Also of points in a plane, where a mirror image would fit as well."""
    random = np.random.default_rng(3)
    turn = random.normal(size=4)
    pose = np.concatenate([[1e-3, -2e-3, 5e-4], turn / np.linalg.norm(turn)])
    motion = matrix_of(pose)
    for points in (random.normal(size=(8, 3)), random.normal(size=(8, 3)) * [1, 1, 0]):
        moved = points @ motion[:3, :3].T + motion[:3, 3]
        np.testing.assert_allclose(rigid_fit(points, moved), motion, atol=1e-12)


def test_a_fit_is_the_nearest() -> None:
    random = np.random.default_rng(4)
    points, moved = random.normal(size=(2, 12, 3))
    best = rigid_fit(points, moved)

    def miss(motion: np.ndarray) -> float:
        return float(((points @ motion[:3, :3].T + motion[:3, 3] - moved) ** 2).sum())

    for _ in range(20):
        turn = np.append(1e-2 * random.normal(size=3), 1.0)
        small = np.concatenate([1e-2 * random.normal(size=3), turn / np.linalg.norm(turn)])
        assert miss(best) < miss(best @ matrix_of(small))


def test_mechanisms_need_their_own_parts(tmp_path: Path) -> None:
    text = (FILES / "tac-man-revolute.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("hinge_mm = 200.0\n", ""), encoding="utf-8")
    with pytest.raises(InputError, match="joint 'revolute' needs handle_mm, hinge_mm"):
        read_task(path)


def test_a_door_opens_and_needs_recovery() -> None:
    """By 5 degrees: the hand has turned with the handle, and markers are back where they were."""
    task = named("tac-man-revolute")
    assert isinstance(task.parameters, TacManParameters)
    goal = task.parameters.goal.replace(opened_deg=5.0)
    task = replace(task, parameters=task.parameters.replace(goal=goal))
    (trial,) = run_task(task, [0], "cpu").trials
    assert trial.success, trial.cause
    assert trial.figures["switches"] >= 2
    assert 5.0 <= trial.figures["opened_deg"] < 5.5
    assert trial.figures["path_error_mm"] < 0.6


def test_a_hand_that_does_not_press_gives_up() -> None:
    """Too few markers are pushed in: the grip is said to have failed."""
    task = named("tac-man-prismatic")
    assert isinstance(task.parameters, TacManParameters)
    policy = task.parameters.policy.replace(squeeze_mm=0.1)
    (trial,) = run_task(
        replace(task, parameters=task.parameters.replace(policy=policy)), [0], "cpu"
    ).trials
    assert trial.cause == "the grip failed" and trial.figures["markers"] < 6
    assert trial.steps == policy.close_steps + policy.settle_steps
