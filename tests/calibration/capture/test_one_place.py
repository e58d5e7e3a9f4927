# SPDX-License-Identifier: Apache-2.0
"""Presses that lie in one place: what most of them touch is no untouched gel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import CapturedPress, CaptureFolder, ContactCircle
from taccel_lab.calibration.capture.folder import Frame
from taccel_lab.calibration.check import CaptureCheck, check_captures
from taccel_lab.calibration.check.background import median_background
from tests.support.capture_sets import CaptureMaker, gel, press, spread_circles
from tests.support.real_data import labelled_presses

BALL_MM = 8.0
Image = Callable[[CaptureFolder], np.ndarray]


def wide(count: int = 8, away_px: float = 6.0) -> CaptureMaker:
    """Presses of a large ball whose contacts, in one place, cover half of the view."""
    rng = np.random.default_rng(3)
    circles = [
        ContactCircle(
            80 + rng.uniform(-away_px, away_px),
            60 + rng.uniform(-away_px, away_px),
            rng.uniform(50, 58),
        )
        for _ in range(count)
    ]
    return CaptureMaker(circles, images=[press(one, BALL_MM) for one in circles], radius_mm=BALL_MM)


def with_background(folder: CaptureFolder, image: np.ndarray) -> CaptureFolder:
    return replace(folder, background=Frame("background", "memory", "0" * 64, lambda: image))


def codes(found: CaptureCheck) -> dict[str, str]:
    return {finding.code: finding.message for finding in found.findings}


def all_found(found: CaptureCheck) -> bool:
    return all(frame.contact is not None for frame in found.frames)


@pytest.mark.thorough
@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_a_good_background_stands(tmp_path: Path, count: int) -> None:
    found = check_captures(wide(count).load(tmp_path), fit_ball=False)
    assert found.background is not None and not found.background.is_median
    assert not {"background_differs", "mixed_sensors"} & set(codes(found)) and all_found(found)


@pytest.mark.thorough
def test_presses_of_one_place_are_of_one_sensor(tmp_path: Path) -> None:
    """Deep and shallow ones differ where they touch alone."""
    radii = np.linspace(24, 44, 8)
    circles = [ContactCircle(80.0, 60.0, float(radius)) for radius in radii]
    images = [press(circle, 6.0) for circle in circles]
    maker = CaptureMaker(circles, images=images, radius_mm=6.0)
    assert "mixed_sensors" not in codes(check_captures(maker.load(tmp_path), fit_ball=False))


def older(_: CaptureFolder) -> np.ndarray:
    """The same gel with its lamps set otherwise."""
    height, width = gel().shape[:2]
    light = np.outer(np.linspace(-1, 1, height), np.linspace(-1, 1, width))
    return np.clip(gel() + 40 * light[..., None] * [1.0, -0.5, 0.0], 0, 255).astype(np.uint8)


def of_another_unit(_: CaptureFolder) -> np.ndarray:
    return np.flip(gel(), 1).astype(np.uint8)


@pytest.mark.thorough
@pytest.mark.parametrize("image", [older, of_another_unit])
def test_a_wrong_background_is_told_and_the_pressed_median_takes_no_place(
    tmp_path: Path, image: Image
) -> None:
    folder = wide().load(tmp_path)
    found = check_captures(with_background(folder, image(folder)), fit_ball=False)
    assert "the median of the presses shows a press" in codes(found)["background_differs"]
    assert found.background is not None and not found.background.is_median


@pytest.mark.thorough
def test_a_median_that_shows_a_press_is_no_background(tmp_path: Path) -> None:
    folder = wide().load(tmp_path / "one")
    said = codes(check_captures(replace(folder, background=None), fit_ball=False))
    assert "a contact stands out of it in 0 of 8 presses" in said["no_background"]
    taken = with_background(folder, median_background(folder.presses))
    found = check_captures(taken, fit_ball=False)
    assert "median_pressed" in codes(found) and not found.usable
    spread = CaptureMaker(spread_circles(8)).load(tmp_path / "spread")
    taken = with_background(spread, median_background(spread.presses))
    found = check_captures(taken, fit_ball=False)
    assert "median_pressed" not in codes(found) and all_found(found)


@pytest.mark.thorough
def test_real_presses_of_one_place_keep_their_background(tmp_path: Path) -> None:
    captures = labelled_presses(
        "fots_calib", "labels_gelsight.csv", "mlp_calib/0000.png", 2.35, 4.7 / 92
    )
    middle = captures.presses[len(captures.presses) // 2].circle
    assert middle is not None

    def near(one: CapturedPress) -> bool:
        return one.circle is not None and (
            one.circle.center_gap_px(middle, captures.grid) < middle.radius_px
        )

    presses = tuple(one for one in captures.presses if near(one))
    folder = CaptureFolder(
        source="fots", root=tmp_path, sensor="gelsight_mini", unit=None, untouched=(), mask=None,
        background=Frame("background", "0000.png", "0" * 64, partial(np.copy, captures.background)),
        mm_per_px=(4.7 / 92, 4.7 / 92), ball_radius_mm=2.35, presses=presses,
    )  # fmt: skip
    found = check_captures(folder, fit_ball=False)
    assert len(presses) > 7 and all_found(found)
    assert found.background is not None and not found.background.is_median
    assert "background_differs" not in codes(found)
    without = check_captures(replace(folder, background=None), fit_ball=False)
    assert "contacts lie over one place, around (" in codes(without)["no_background"]
