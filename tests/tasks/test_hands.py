# SPDX-License-Identifier: Apache-2.0
"""Hands with gels: how they close, and where they stand."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.tasks.catalogue import named
from taccel_lab.tasks.grasp_matrix import GraspMatrixParameters
from taccel_lab.tasks.hands import Finger, HandWithGels, Seat
from tests.support.robot_files import REAL_NAMES, needs_real_robots

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")


def parameters() -> GraspMatrixParameters:
    found = named("grasp-lift-matrix").parameters
    assert isinstance(found, GraspMatrixParameters)
    return found


HANDS = [
    pytest.param(name, marks=needs_real_robots) if name in REAL_NAMES else name
    for name in parameters().hands
]


def made(name: str) -> HandWithGels:
    return HandWithGels(parameters().hands[name], parameters().gel)


def gel_frames(hand: HandWithGels, name: str, ways_m: np.ndarray) -> np.ndarray:
    """Frames of the gels with the middle of the hand at the origin, [n, gel, 4, 4]."""
    links = matrix_of(hand.robot.targets(hand.coordinates(ways_m)))[:, : len(hand.gels)]
    base = hand.base(0.5)
    base[2] -= 0.5
    return matrix_of(base[None])[0] @ links


@pytest.mark.parametrize("name", HANDS)
def test_gels_go_inwards_and_look_there(name: str) -> None:
    hand = made(name)
    parts = np.linspace(0, 1, 9)[:, None]
    frames = gel_frames(hand, name, parts * hand.lengths_m)
    places, normals = frames[..., :3, 3], frames[..., :3, 2]
    # Opposed along y in the Panda hand, along x in the others; Allegro's lanes lie beside each
    # other, so that what counts is the way of closing.
    closing = places[-1] - places[0]
    ways = closing / np.linalg.norm(closing, axis=1, keepdims=True)
    assert np.linalg.norm(closing, axis=1).min() > 0.025
    assert np.abs(ways[:, 2]).max() < 0.25
    assert (np.einsum("ngi,gi->ng", normals, ways) > 0.9).all()
    # Ways of all gels cancel: what they push does not go anywhere.
    assert (ways @ ways.T).min() < -0.45
    assert (places[0] * ways).sum(axis=1).max() < -0.03


@pytest.mark.parametrize("name", HANDS)
def test_a_way_is_that_of_the_gel(name: str) -> None:
    hand = made(name)
    ways = np.linspace(0, 1, 400)[:, None] * hand.lengths_m
    places = gel_frames(hand, name, ways)[..., :3, 3]
    first = [int(np.flatnonzero(hand.finger_of == i)[0]) for i in range(len(hand.lengths_m))]
    gone = np.linalg.norm(np.diff(places[:, first], axis=0), axis=2).sum(axis=0)
    # The seat, whose way it is, lies half a gel behind the gel's frame.
    np.testing.assert_allclose(gone, hand.lengths_m, rtol=0.06)


@needs_real_robots
def test_hands_stand_as_high_as_asked_but_not_lower_than_they_may() -> None:
    described = parameters().hands["allegro_right"]
    hand = made("allegro_right")
    middle = np.array([*(1e-3 * np.array(described.middle_mm)), 1.0])
    for asked, found in ((0.1, 0.1), (0.0, 1e-3 * described.lowest_mm)):
        frame = matrix_of(hand.base(asked)[None])[0]
        np.testing.assert_allclose((frame @ middle)[:3], [0.0, 0.0, found], atol=1e-12)


def test_wrong_fingers_are_refused_by_name() -> None:
    described = parameters().hands["parallel_gripper"]
    finger = described.fingers[0]
    for changed, message in (
        (finger.replace(joints=("slide",)), "no coordinate 'slide'; there are slide_left"),
        (finger.replace(gels=(Seat(link="thumb"),)), "no link 'thumb'"),
        (finger.replace(links=("thumb",)), "no link 'thumb'"),
    ):
        with pytest.raises(InputError, match=message):
            HandWithGels(described.replace(fingers=(changed,)), parameters().gel)
    for path, message in (([[0.1, 0.2], [0.0]], "needs 1 coord"), ([[0.1], [0.1]], "must differ")):
        with pytest.raises(ValueError, match=message):
            Finger(joints=("slide_left",), path=path, gels=finger.gels, links=())  # type: ignore[arg-type]
