# SPDX-License-Identifier: Apache-2.0
"""A matrix of hands and objects: its cells, and grasps of some of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from taccel_lab.errors import InputError
from taccel_lab.tasks.catalogue import FILES, Task, named, read_task
from taccel_lab.tasks.grasp_matrix import GraspMatrix, GraspMatrixParameters
from taccel_lab.tasks.run import run_task
from tests.support.robot_files import REAL_NAMES, needs_real_robots

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")


def matrix() -> tuple[Task, GraspMatrixParameters]:
    task = named("grasp-lift-matrix")
    assert isinstance(task.parameters, GraspMatrixParameters)
    return task, task.parameters


HANDS = [
    pytest.param(name, marks=needs_real_robots) if name in REAL_NAMES else name
    for name in matrix()[1].hands
]


def seed_of(hand: str, shape: str, start: int = 0) -> int:
    _, parameters = matrix()
    row = list(parameters.hands).index(hand)
    column = [thing.shape for thing in parameters.objects].index(shape)
    return (row * len(parameters.objects) + column) * parameters.starts + start


def test_four_hands_and_ten_objects_have_the_same_starts() -> None:
    task, parameters = matrix()
    cells = [parameters.cell(seed) for seed in range(parameters.seeds)]
    names = [(hand, thing.shape) for hand, thing in cells]
    assert len(set(names)) == 40 and len(parameters.hands) == 4
    assert all(names.count(cell) == parameters.starts for cell in set(names))
    numbers = [parameters.drawn(seed) for seed in range(parameters.seeds)]
    assert numbers[: parameters.starts] == list(range(parameters.starts))
    assert numbers == numbers[: parameters.starts] * 40
    # Beyond all cells: further starts of the first one.
    assert parameters.cell(parameters.seeds) == cells[0]
    assert parameters.drawn(parameters.seeds) == parameters.starts
    ours = [hand for hand in parameters.hands if hand not in REAL_NAMES]
    starts = [task.begin([seed_of(hand, "gear", 5)], "cpu").starts for hand in ours]
    assert starts == [starts[0]] * 2


def test_seeds_of_two_cells_are_two_solvers() -> None:
    task, parameters = matrix()
    most = parameters.starts
    seeds = [0, most + 1, 1, *range(2, 10)]
    groups = GraspMatrix.groups(parameters, seeds)
    assert [list(group) for group in groups] == [[*range(8)], [8, 9], [most + 1]]
    with pytest.raises(InputError, match="of one cell"):
        task.begin([0, most], "cpu")


@pytest.mark.parametrize("hand", HANDS)
def test_every_hand_begins_free_of_everything(hand: str) -> None:
    """The widest and the lowest object."""
    task, _ = matrix()
    seeds = [seed_of(hand, "gear", start) for start in (0, 1)]
    result = run_task(task, seeds, "cpu", steps=3)
    assert [trial.steps for trial in result.trials] == [3, 3]
    for trial in result.trials:
        assert trial.cell == (hand, "gear")
        assert trial.cause.startswith("never gripped: 0 of")


def test_three_fingers_lift_a_ball_and_stop_when_it_is_held() -> None:
    task, parameters = matrix()
    (trial,) = run_task(task, [seed_of("three_finger_hand", "ball")], "cpu").trials
    assert trial.success and trial.steps < parameters.steps
    assert trial.figures["gels_pushing"] == 3
    assert 1.0 <= trial.figures["held_s"] < 1.03
    # Three gels at 120 degrees carry 0.98 N with friction of 0.333.
    assert trial.figures["weakest_grip_n"] > 0.98 / 3 / 0.334 / 2
    assert trial.figures["strongest_grip_n"] < parameters.policy.most_n


def test_an_object_too_heavy_for_its_grip_slips() -> None:
    task, parameters = matrix()
    heavy = parameters.replace(body=parameters.body.replace(mass_kg=0.4))
    seed = seed_of("parallel_gripper", "dowel")
    (trial,) = run_task(replace(task, parameters=heavy), [seed], "cpu").trials
    assert trial.cause.startswith("slipped: rose by")
    assert trial.figures["slip_mm"] > parameters.policy.lost_mm
    assert trial.figures["gels_pushing"] == 2


def test_unknown_shapes_are_refused(tmp_path: Path) -> None:
    text = (FILES / "grasp-lift-matrix.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    for old, new, message in (
        ('shape = "gear"', 'shape = "spoon"', "no shapes spoon; there are hex nut, washer"),
        ('shape = "gear"', 'shape = "dowel"', "names one shape twice"),
    ):
        path.write_text(text.replace(old, new), encoding="utf-8")
        with pytest.raises(InputError, match=message):
            read_task(path)
