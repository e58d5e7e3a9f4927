# SPDX-License-Identifier: Apache-2.0
"""Hands with gels: how they close, where they stand, and a matrix of hands and objects."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.tasks.catalogue import named, run_task
from taccel_lab.tasks.grasp_matrix import Finger, GraspMatrix, HandWithGels, PadSeat
from tests.support.robot_files import REAL_NAMES, needs_real_robots
from tests.tasks.changed import first_trial, parameters, task_with

TASK = named("grasp-lift-matrix")
MATRIX = parameters("grasp-lift-matrix")
HANDS = [
    pytest.param(name, marks=needs_real_robots) if name in REAL_NAMES else name
    for name in MATRIX.hands
]


def made(name: str) -> HandWithGels:
    return HandWithGels(MATRIX.hands[name], MATRIX.gel)


def gel_frames(hand: HandWithGels, travels_m: np.ndarray) -> np.ndarray:
    """Frames of the gels with the middle of the hand at the origin, [n, gel, 4, 4]."""
    links = matrix_of(hand.robot.targets(hand.coordinates(travels_m)))[:, : len(hand.gels)]
    base = hand.base(0.5)
    base[2] -= 0.5
    return matrix_of(base[None])[0] @ links


@pytest.mark.parametrize("name", HANDS)
def test_gels_go_inwards_and_look_there(name: str) -> None:
    hand = made(name)
    parts = np.linspace(0, 1, 9)[:, None]
    frames = gel_frames(hand, parts * hand.lengths_m)
    places, normals = frames[..., :3, 3], frames[..., :3, 2]
    # Opposed along y in the Panda hand, along x in the others; Allegro's lanes lie beside each
    # other, so that what counts is the way of closing.
    closing = places[-1] - places[0]
    travels = closing / np.linalg.norm(closing, axis=1, keepdims=True)
    assert np.linalg.norm(closing, axis=1).min() > 0.025
    assert np.abs(travels[:, 2]).max() < 0.25
    assert (np.einsum("ngi,gi->ng", normals, travels) > 0.9).all()
    # Ways of all gels cancel: what they push does not go anywhere.
    assert (travels @ travels.T).min() < -0.45
    assert (places[0] * travels).sum(axis=1).max() < -0.03


@pytest.mark.parametrize("name", HANDS)
def test_a_way_is_that_of_the_gel(name: str) -> None:
    hand = made(name)
    travels = np.linspace(0, 1, 400)[:, None] * hand.lengths_m
    places = gel_frames(hand, travels)[..., :3, 3]
    first = [int(np.flatnonzero(hand.finger_of == i)[0]) for i in range(len(hand.lengths_m))]
    gone = np.linalg.norm(np.diff(places[:, first], axis=0), axis=2).sum(axis=0)
    # The seat, whose way it is, lies half a gel behind the gel's frame.
    np.testing.assert_allclose(gone, hand.lengths_m, rtol=0.06)


@needs_real_robots
def test_hands_stand_as_high_as_asked_but_not_lower_than_they_may() -> None:
    described = MATRIX.hands["allegro_right"]
    hand = made("allegro_right")
    middle = np.array([*(1e-3 * np.array(described.middle_mm)), 1.0])
    for asked, found in ((0.1, 0.1), (0.0, 1e-3 * described.lowest_mm)):
        frame = matrix_of(hand.base(asked)[None])[0]
        np.testing.assert_allclose((frame @ middle)[:3], [0.0, 0.0, found], atol=1e-12)


def test_wrong_fingers_are_refused_by_name() -> None:
    described = MATRIX.hands["parallel_gripper"]
    finger = described.fingers[0]
    for changed, message in (
        (finger.replace(joints=("slide",)), "no coordinate 'slide'; there are slide_left"),
        (finger.replace(gels=(PadSeat(link="thumb"),)), "no link 'thumb'"),
        (finger.replace(links=("thumb",)), "no link 'thumb'"),
    ):
        with pytest.raises(InputError, match=message):
            HandWithGels(described.replace(fingers=(changed,)), MATRIX.gel)
    for path, message in (([[0.1, 0.2], [0.0]], "needs 1 coord"), ([[0.1], [0.1]], "must differ")):
        with pytest.raises(ValueError, match=message):
            Finger(joints=("slide_left",), path=path, gels=finger.gels, links=())  # type: ignore[arg-type]


def seed_of(hand: str, shape: str, start: int = 0) -> int:
    row = list(MATRIX.hands).index(hand)
    column = [thing.shape for thing in MATRIX.objects].index(shape)
    return (row * len(MATRIX.objects) + column) * MATRIX.starts + start


def test_four_hands_and_ten_objects_have_the_same_starts() -> None:
    cells = [MATRIX.cell(seed) for seed in range(MATRIX.seeds)]
    names, most = [(hand, thing.shape) for hand, thing in cells], MATRIX.starts
    assert len(set(names)) == 40 and len(MATRIX.hands) == 4
    assert all(names.count(cell) == most for cell in set(names))
    assert [MATRIX.drawn(seed) for seed in range(MATRIX.seeds)] == list(range(most)) * 40
    # Beyond all cells: further starts of the first one.
    assert MATRIX.cell(MATRIX.seeds) == cells[0] and MATRIX.drawn(MATRIX.seeds) == most
    ours = [hand for hand in MATRIX.hands if hand not in REAL_NAMES]
    starts = [TASK.begin([seed_of(hand, "gear", 5)], "cpu").starts for hand in ours]
    assert starts == [starts[0]] * 2


def test_seeds_of_two_cells_are_two_solvers() -> None:
    most = MATRIX.starts
    seeds = [0, most + 1, 1, *range(2, 10)]
    groups = GraspMatrix.groups(MATRIX, seeds)
    assert [list(group) for group in groups] == [[*range(8)], [8, 9], [most + 1]]
    with pytest.raises(InputError, match="of one cell"):
        TASK.begin([0, most], "cpu")


@pytest.mark.parametrize("hand", HANDS)
def test_every_hand_begins_free_of_everything(hand: str) -> None:
    seeds = [seed_of(hand, "gear", start) for start in (0, 1)]
    result = run_task(TASK, seeds, "cpu", steps=3)
    assert [trial.steps for trial in result.trials] == [3, 3]
    for trial in result.trials:
        assert trial.cell == (hand, "gear")
        assert trial.cause.startswith("never gripped: 0 of")


@pytest.mark.thorough
def test_three_fingers_lift_a_ball_and_stop_when_it_is_held() -> None:
    trial = first_trial(TASK, seed_of("three_finger_hand", "ball"))
    assert trial.success and trial.steps < MATRIX.steps
    assert trial.figures["gels_pushing"] == 3
    assert 1.0 <= trial.figures["held_s"] < 1.03
    # Three gels at 120 degrees carry 0.98 N with friction of 0.333.
    assert trial.figures["weakest_grip_n"] > 0.98 / 3 / 0.334 / 2
    assert trial.figures["strongest_grip_n"] < MATRIX.policy.most_n


@pytest.mark.thorough
def test_an_object_too_heavy_for_its_grip_slips() -> None:
    heavy = task_with("grasp-lift-matrix", body={"mass_kg": 0.4})
    trial = first_trial(heavy, seed_of("parallel_gripper", "dowel"))
    assert trial.cause.startswith("slipped: rose by")
    assert trial.figures["slip_mm"] > MATRIX.policy.lost_mm
    assert trial.figures["gels_pushing"] == 2
