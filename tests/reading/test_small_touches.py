# SPDX-License-Identifier: Apache-2.0
"""Touches of hundredths of a millimetre are seen, and what is none stays none."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.reading.reading import Reading
from tests.support.pressed_mini import PressedMini, ball, flat, inside

MOST_N = 0.2
V, U = np.mgrid[-1:1:240j, -1:1:320j]


@pytest.fixture(scope="module")
def mini() -> PressedMini:
    return PressedMini()


def lowest_ends(found: Reading) -> tuple[float, float]:
    assert found.depth_interval_mm is not None and found.force_interval_n is not None
    return found.depth_interval_mm[0], found.force_interval_n[0]


@pytest.mark.parametrize("at", [(0.0, 0.0), (-7.0, 4.0), (6.0, -5.0)])
@pytest.mark.parametrize("depth_mm", [0.05, 0.1])
def test_a_shallow_ball_is_told_from_nothing(
    mini: PressedMini, depth_mm: float, at: tuple[float, float]
) -> None:
    """By depth and force, whose intervals hold the truth. Before, both began at 0 up to 0.2 mm."""
    found, force_n, _ = mini.press(ball(4.0, depth_mm, *at))
    assert found.touch.any and min(lowest_ends(found)) > 0
    assert inside(depth_mm, found.depth_interval_mm) and inside(force_n, found.force_interval_n)


def weaker(image: np.ndarray, channel: int, at: tuple[float, float], share: float) -> np.ndarray:
    """One lamp is weaker around a place."""
    part = share * np.exp(-((U - at[0]) ** 2 + (V - at[1]) ** 2) / (2 * 0.6**2))
    return image * (1 - part[..., None] * (np.arange(3) == channel))


@pytest.mark.parametrize("channel", range(3))
@pytest.mark.parametrize("at", [(-1.0, 0.0), (0.5, 1.0)])
@pytest.mark.parametrize("share", [0.08, -0.05])
def test_one_lamp_that_has_changed_over_a_part_of_the_view_is_no_touch(
    mini: PressedMini, channel: int, at: tuple[float, float], share: float
) -> None:
    """Before, 8 % less read 0.8 to 1.8 N."""
    found = mini.reader(mini.noisy(weaker(mini.levels(mini.still), channel, at, share)))
    assert not found.touch.any and found.force_interval_n[1] < MOST_N
    if share > 0.05:
        assert any("one lamp" in note for note in found.notes)


@pytest.mark.parametrize("tool", ["roller", "ridge", "half plane", "wide ball"])
def test_no_press_is_taken_for_a_lamp(mini: PressedMini, tool: str) -> None:
    """Nor one whose slopes have one direction."""
    gap = {
        "roller": lambda x, y: (x + 0 * y) ** 2 / 24 - 0.2,
        "ridge": flat(lambda x, y: np.abs(x) < 1.5, 0.1),
        "half plane": flat(lambda x, y: x > 3.0, 0.1),
        "wide ball": ball(50.0, 0.2),
    }[tool]
    found, force_n, _ = mini.press(gap)
    assert not any("lamp" in note for note in found.notes)
    assert found.touch.any and inside(force_n, found.force_interval_n)


SPECKS: dict[str, Callable[[np.ndarray], tuple[float, ...]]] = {
    "dark grey": lambda image: (float(image.mean()) - 40.0,) * 3,
    "black": lambda image: (20.0, 20.0, 20.0),
    "a bright fibre's end": lambda image: (230.0, 220.0, 210.0),
}


@pytest.mark.parametrize("kind", SPECKS)
def test_a_speck_on_a_colour_sensor_is_dirt(mini: PressedMini, kind: str) -> None:
    """Before, nothing was said, and a press beside it was read with it."""
    levels = mini.levels(mini.still)
    cv2.circle(levels, (106, 120), 4, SPECKS[kind](levels), -1, cv2.LINE_AA)
    found = mini.reader(mini.noisy(levels))
    assert not found.touch.any and found.force_interval_n[1] < MOST_N
    assert any("a speck" in note and "(106, 120) px" in note for note in found.notes)


@pytest.mark.parametrize("radius_mm", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("depth_mm", [0.1, 0.3])
def test_no_ball_is_taken_for_a_speck(mini: PressedMini, radius_mm: float, depth_mm: float) -> None:
    found, _, _ = mini.press(
        lambda x, y: (
            radius_mm
            - np.sqrt(np.maximum(radius_mm**2 - x**2 - y**2, (0.01 * radius_mm) ** 2))
            - depth_mm
        )
    )
    assert found.touch.any and not any("speck" in note for note in found.notes)


def test_noise_that_no_training_had_widens_what_is_stated(mini: PressedMini) -> None:
    """By as much as there is more of it, or more where the networks notice it, too."""
    levels, sigmas = mini.levels(mini.still), []
    for size in (4.0, 8.0):
        field = np.random.default_rng(3).normal(0, 1, levels.shape)
        field = cv2.GaussianBlur(field, (0, 0), 4.0)
        found = mini.reader(mini.noisy(levels + size * field / field.std()))
        assert not found.touch.any
        assert found.reading_sigma_m is not None
        sigmas.append(float(np.median(found.reading_sigma_m)))
    assert 1.9 < sigmas[1] / sigmas[0] < 2.6


def test_a_frame_is_read_the_same_whatever_came_before(mini: PressedMini) -> None:
    """After a deep press a shallow touch is seen in the next frame; a sensor whose gel relaxes is
    followed by time, which these frames have none of."""
    deep, shallow = (
        mini.seen(mini.pressed(ball(4.0, depth))[0], seed=seed)
        for depth, seed in ((0.9, 1), (0.21, 2))
    )
    still = mini.seen(mini.still, seed=3)
    frames = [shallow, deep, shallow, still, shallow, deep, still]
    found = list(tl.Reader(mini.sensor, background=mini.seen(mini.still)).stream(frames))
    assert [one.touch.any for one in found] == [True, True, True, False, True, True, False]
    for frame, one in zip(frames, found, strict=True):
        alone = tl.Reader(mini.sensor, background=mini.seen(mini.still))(frame)
        assert one.depth_mm == alone.depth_mm and one.force_n == alone.force_n
        assert one.depth_interval_mm == alone.depth_interval_mm
        assert np.array_equal(one.depth_m, alone.depth_m)
    assert inside(0.21, found[2].depth_interval_mm) and lowest_ends(found[2])[0] > 0
