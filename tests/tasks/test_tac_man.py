# SPDX-License-Identifier: Apache-2.0
"""Execution and recovery, and a throw: markers' fit, mechanisms, a ball in free flight."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.robots.transforms import matrix_of
from taccel_lab.tasks.catalogue import Task
from taccel_lab.tasks.tac_man import rigid_fit
from taccel_lab.tasks.throw_catch import ThrowCatch
from tests.tasks.changed import first_trial, parameters, task_with


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


@pytest.mark.thorough
def test_a_door_opens_and_needs_recovery() -> None:
    """By 5 degrees: the hand has turned with the handle, and markers are back where they were."""
    trial = first_trial(task_with("tac-man-revolute", goal={"opened_deg": 5.0}))
    assert trial.success, trial.cause
    assert trial.figures["switches"] >= 2
    assert 5.0 <= trial.figures["opened_deg"] < 5.5
    assert trial.figures["path_error_mm"] < 0.6


def test_a_hand_that_does_not_press_gives_up() -> None:
    task = task_with("tac-man-prismatic", policy={"squeeze_mm": 0.1})
    trial, policy = first_trial(task), parameters("tac-man-prismatic").policy
    assert trial.cause == "the grip failed" and trial.figures["markers"] < 6
    assert trial.steps == policy.close_steps + policy.settle_steps


def even(late_s: float = 0.0) -> Task:
    """Without anything drawn, but for how late gels close."""
    return task_with("throw-catch", start={"place_mm": 0.0, "speed_part": 0.0, "late_s": late_s})


@pytest.mark.thorough
def test_a_throw_as_meant_is_caught() -> None:
    trial = first_trial(even())
    assert trial.success, trial.cause
    assert trial.figures["off_mm"] < 10 and trial.figures["held_s"] > 0.3


@pytest.mark.thorough
def test_the_ball_flies_as_thrown_bodies_do() -> None:
    episode = even().begin([0], "cpu")
    assert isinstance(episode, ThrowCatch)
    heights, free = [], []
    for _ in range(52):
        episode.advance()
        heights.append(episode.affine_frame()[0][0, 2])
        free.append(max(episode.forces().values()) == 0)
    flight = np.flatnonzero(free)[4:]
    assert len(flight) > 20 and (np.diff(flight) == 1).all()
    dt = episode.parameters.dt_s
    bend = np.diff(np.array(heights)[flight], 2) / dt**2
    np.testing.assert_allclose(bend, -9.81, rtol=0.02)
    way = np.array(heights)[flight].max() - heights[flight[0]]
    speed = (heights[flight[1]] - heights[flight[0]]) / dt
    assert way == pytest.approx(speed**2 / (2 * 9.81), rel=0.1)


@pytest.mark.thorough
def test_gels_that_close_too_late_miss() -> None:
    late = even(late_s=0.2)
    seed = next(s for s in range(100) if late.begin([s], "cpu").starts[0]["late_s"] > 0.1)
    trial = first_trial(late, seed)
    assert not trial.success and "was held for 0.00 s" in trial.cause
