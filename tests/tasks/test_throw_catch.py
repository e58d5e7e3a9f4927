# SPDX-License-Identifier: Apache-2.0
"""A ball that is thrown flies as thrown bodies do, and is caught by gels that close in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.tasks.catalogue import Task, named
from taccel_lab.tasks.run import run_task
from taccel_lab.tasks.throw_catch import ThrowCatch, ThrowCatchParameters


def even(**changes: float) -> Task:
    """Without anything drawn, but for the changes."""
    task = named("throw-catch")
    assert isinstance(task.parameters, ThrowCatchParameters)
    none = {"place_mm": 0.0, "speed_part": 0.0, "late_s": 0.0}
    start = task.parameters.start.replace(**{**none, **changes})
    return replace(task, parameters=task.parameters.replace(start=start))


def test_a_throw_as_meant_is_caught() -> None:
    (trial,) = run_task(even(), [0], "cpu").trials
    assert trial.success, trial.cause
    assert trial.figures["off_mm"] < 10 and trial.figures["held_s"] > 0.3


def test_the_ball_flies_as_thrown_bodies_do() -> None:
    """While nothing touches it, its height has the second difference of free fall."""
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


def test_gels_that_close_too_late_miss() -> None:
    task = named("throw-catch")
    assert isinstance(task.parameters, ThrowCatchParameters)
    late = even(late_s=0.2)
    seed = next(s for s in range(100) if late.begin([s], "cpu").starts[0]["late_s"] > 0.1)
    (trial,) = run_task(late, [seed], "cpu").trials
    assert not trial.success and "was held for 0.00 s" in trial.cause
