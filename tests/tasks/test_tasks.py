# SPDX-License-Identifier: Apache-2.0
"""Every task: its file, its starts, three steps; slow ones run the baseline and check its rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.tasks.catalogue import FILES, named, names, read_task, run_task
from taccel_lab.tasks.draw import draw
from taccel_lab.tasks.parameters import PlanarStart
from tests.support.variants import variants
from tests.tasks.changed import first_trial, task_with


def kind_of(name: str) -> str:
    return type(named(name).parameters).__name__


DEAR = """ball-rolling grasp-lift-driven nut-m16 object-classification peg-insertion peg-tacex
    soft-bear tac-man-helical throw-catch twist"""


@pytest.mark.thorough(cases=DEAR.split())
@pytest.mark.parametrize(
    "name", variants({kind_of(name): name for name in reversed(names())}.values(), names())
)
def test_three_steps_are_the_same_whatever_runs_beside_them(name: str) -> None:
    told: list[tuple[int, int]] = []
    task = named(name)
    result = run_task(task, [5, 2], "cpu", steps=3, progress=lambda _, i, n: told.append((i, n)))
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert [trial.seed for trial in result.trials] == [5, 2]
    for trial in result.trials:
        assert trial.steps == 3 and not trial.success
        assert trial.cause and not trial.cause.startswith("solver")
    alone, together = run_task(task, [2], "cpu", steps=3).trials[0], result.trials[1]
    assert alone.start == together.start
    assert alone.figures == pytest.approx(together.figures, rel=1e-3, abs=1e-4, nan_ok=True)


def test_draws_fill_their_ranges_evenly() -> None:
    drawn = [draw(seed, {"x": 2.0, "y": 0.0}) for seed in range(400)]
    x = np.array([start["x"] for start in drawn])
    assert np.abs(x).max() <= 2.0 and abs(x.mean()) < 0.2
    assert x.std() == pytest.approx(2.0 / np.sqrt(3), rel=0.06)
    assert all(start["y"] == 0 for start in drawn)
    assert draw(7, {"x": 2.0}) == {"x": drawn[7]["x"]}


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("grasp-lift", 'kind = "grasp-lift"', 'kind = "juggle"', "kind must be one of .*grasp-l"),
        ("grasp-lift", "mass_kg = 0.1", "mass_kg = -0.1", r"object\.mass_kg"),
        ("grasp-lift", "seeds = 64", "seeds = 64\ncolour = 3", "colour: unknown key"),
        ("peg-insertion", "[0.0, 0.02, 0.1, 1.0]", "[0.0, 1.0]", "each of the 2 times_s, got 4"),
        ("peg-insertion", "[0.0, 0.02,", "[0.0, 0.2,", "times_s must rise"),
        ("grasp-lift-matrix", 'shape = "gear"', 'shape = "spoon"', "no shapes spoon; there are"),
        ("grasp-lift-matrix", 'shape = "gear"', 'shape = "dowel"', "names one shape twice"),
        ("object-classification", '"gear"', '"spoon"', "no parts spoon; there are hex nut, washer"),
        ("object-classification", '"gear"', '"washer"', "names one part twice"),
        ("tac-man-revolute", "hinge_mm = 200.0\n", "", "'revolute' needs handle_mm, hinge_mm"),
    ],
)
def test_wrong_files(tmp_path: Path, name: str, old: str, new: str, message: str) -> None:
    text = (FILES / f"{name}.toml").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_task(path)


def test_tasks_that_are_not_there_and_no_seeds_are_refused() -> None:
    with pytest.raises(InputError, match=r"no task 'juggle'; taccel-lab task list"):
        named("juggle")
    with pytest.raises(InputError, match="at least one seed"):
        run_task(named("grasp-lift"), [])


def test_an_environment_that_fails_is_a_failure_with_its_cause() -> None:
    """The pads begin 11 mm from the middle, the box reaches to 10 mm and lies off it by up to 2."""
    start = PlanarStart(x_mm=2.0, y_mm=0.0, yaw_deg=0.0)
    task = task_with("grasp-lift", policy={"open_mm": 15.0}, start=start)
    good, bad = run_task(task, [0, 3], "cpu", steps=4).trials
    assert abs(good.start["x_mm"]) < 0.9 and abs(bad.start["x_mm"]) > 1.1
    assert good.steps == 4 and good.cause.startswith("rose by")
    assert bad.steps == 0 and not bad.success and bad.cause == "solver: OVERLAP in step 1"


@pytest.mark.thorough
def test_ctrl_c_keeps_the_groups_that_are_done() -> None:
    task = task_with("grasp-lift", environments=1)

    def stop(name: str, done: int, total: int) -> None:
        if done == 5:
            raise KeyboardInterrupt

    result = run_task(task, [0, 1, 2], "cpu", steps=2, progress=stop)
    assert [trial.seed for trial in result.trials] == [0, 1]
    assert result.asked == 3
    with pytest.raises(KeyboardInterrupt):
        run_task(task, [0, 1], "cpu", steps=6, progress=stop)


def test_the_peg_takes_the_step_of_its_file() -> None:
    """Twice as many steps of half the length bring the gels to the same place."""
    poses = []
    for dt_s, steps in ((0.02, 4), (0.01, 8)):
        episode = task_with("peg-insertion", dt_s=dt_s).begin([0], "cpu")
        for _ in range(steps):
            episode.advance()
        assert episode.running.all() and episode.solver.model.env_count == 1
        poses.append(episode.state.poses.numpy().copy())
        # It begins 1 mm above the rim and is let fall by less until the gels hold it.
        assert -1.0 < episode.judge(0)[1]["depth_mm"] < 0.0
    np.testing.assert_allclose(*poses, atol=1e-12)


@pytest.mark.thorough
def test_a_ball_rolls_half_as_far_as_the_gel() -> None:
    """Without slip on the plane."""
    trial = first_trial(named("ball-rolling"), steps=25)
    assert trial.success
    assert np.hypot(trial.start["goal_x_mm"], trial.start["goal_y_mm"]) > 2
    assert trial.figures["part_of_way"] == pytest.approx(1.0, abs=0.08)
    assert trial.figures["slip_on_plane_mm"] < 0.1
