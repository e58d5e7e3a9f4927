# SPDX-License-Identifier: Apache-2.0
"""Backgrounds of many frames: noise, dust and stains."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from taccel_lab.calibration.capture import CapturedPress, ContactCircle
from taccel_lab.calibration.capture.captures import Frame
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.light.background import calibrate_background
from taccel_lab.calibration.light.background_result import dust_mask, speck_count
from taccel_lab.errors import InputError
from tests.calibration.circles.presses import BALL_MM, GRID, gel, pressed, scattered
from tests.calibration.drawn.faults import add_dust, add_noise, drift, poison, quantise
from tests.support.synthetic_presses import tiny_profile

BASE = tiny_profile(GRID)


def frame(name: str, image: np.ndarray) -> Frame:
    return Frame(name, name, "0" * 64, partial(np.copy, image))


def capture_folder(
    background: np.ndarray | None,
    untouched: list[np.ndarray],
    presses: list[np.ndarray],
    mask: np.ndarray | None = None,
) -> CaptureFolder:
    return CaptureFolder(
        source="memory",
        root=Path(),
        sensor="gelsight",
        unit=None,
        background=None if background is None else frame("background", background),
        untouched=tuple(frame(f"u{i}", image) for i, image in enumerate(untouched)),
        mask=mask,
        mm_per_px=(GRID.mm_per_px_x, GRID.mm_per_px_y),
        ball_radius_mm=BALL_MM,
        presses=tuple(
            CapturedPress(f"p{i}", f"p{i}", "1" * 64, partial(np.copy, image))
            for i, image in enumerate(presses)
        ),
    )


@pytest.mark.thorough
def test_average_is_quieter_and_keeps_no_stain() -> None:
    rng = np.random.default_rng(3)
    light = lambda: (1 + rng.normal(0, 0.03, 3), rng.normal(0, 3, 3))  # noqa: E731
    presses = [
        quantise(add_noise(drift(pressed(c), *light()), 2.0, rng)) for c in scattered(16, seed=1)
    ]
    untouched = [quantise(add_noise(drift(gel(), *light()), 2.0, rng)) for _ in range(4)]
    background = quantise(add_noise(gel(), 2.0, rng))
    result = calibrate_background(capture_folder(background, untouched, presses), BASE)
    before = np.sqrt(np.mean((background - gel()) ** 2))
    after = np.sqrt(np.mean((result.image - gel()) ** 2))
    assert after < 0.55 * before
    # Smoothed over 9 px, nothing of the presses is left.
    assert np.abs(uniform_filter(result.image - gel(), (9, 9, 1))).max() < 1.5
    assert result.noise_levels == pytest.approx(2.0, rel=0.2)
    assert result.spread is not None and result.spread.auto_white_balance
    figures = result.figures()
    assert figures["heldout_l1"] < figures["plain_l1"]
    block = result.apply_to(tiny_profile(GRID)).background
    assert block is not None and block.provenance.verdict == "usable"


@pytest.mark.thorough
def test_background_from_presses_alone() -> None:
    rng = np.random.default_rng(5)
    presses = [quantise(add_noise(pressed(c), 1.0, rng)) for c in scattered(14, seed=1)]
    result = calibrate_background(capture_folder(None, [], presses), BASE)
    assert np.abs(result.image - gel()).mean() < 1.5
    assert "no_untouched_image" in {remark.code for remark in result.remarks}
    with pytest.raises(InputError, match="too few to make one"):
        calibrate_background(capture_folder(None, [], presses[:3]), BASE)
    same = [presses[0]] * 8
    with pytest.raises(InputError, match="spread over the gel"):
        # Eight times the same press, and eight of another: half touch each place.
        calibrate_background(capture_folder(None, [], [*same, *presses[1:2] * 8]), BASE)


def test_masked_pixels_have_no_effect() -> None:
    rng = np.random.default_rng(6)
    mask = np.ones((150, 200), dtype=bool)
    mask[20:60, 30:90] = False
    images = [quantise(add_noise(gel(), 1.5, rng)) for _ in range(4)]
    spoilt = [quantise(poison(image, mask, rng)) for image in images]
    first = calibrate_background(capture_folder(images[0], images[1:], [], mask), BASE)
    second = calibrate_background(capture_folder(images[0], spoilt[1:], [], mask), BASE)
    assert np.array_equal(first.image, second.image)
    assert first.figures()["drift"] == second.figures()["drift"]


@pytest.mark.thorough
def test_a_background_with_a_contact_in_it_is_weak() -> None:
    rng = np.random.default_rng(8)
    touched = ContactCircle(150.0, 50.0, 20.0)
    circles = [c for c in scattered(14, seed=3) if np.hypot(c.u_px - 150, c.v_px - 50) > 40]
    presses = [quantise(add_noise(pressed(circle), 1.5, rng)) for circle in circles]
    spoilt = quantise(add_noise(pressed(touched), 1.5, rng))
    found = calibrate_background(capture_folder(spoilt, [], presses), BASE)
    assert "background_pressed" in {remark.code for remark in found.remarks}
    assert found.figures()["verdict"] == "weak"
    # Nothing is said of what the mask hides, whatever the light does.
    mask = np.ones((150, 200), dtype=bool)
    mask[20:80, 118:182] = False
    warmer = [quantise(poison(drift(p, np.ones(3), np.full(3, 25.0)), mask, rng)) for p in presses]
    hidden = calibrate_background(capture_folder(spoilt, [], warmer, mask), BASE)
    assert "background_pressed" not in {remark.code for remark in hidden.remarks}


def test_dust_that_stays() -> None:
    rng = np.random.default_rng(7)
    dusty = add_dust(gel(), 12, np.random.default_rng(1), radius_px=1.5)
    background = quantise(add_noise(gel(), 1.0, rng))
    later = [quantise(add_noise(dusty, 1.0, rng)) for _ in range(4)]
    result = calibrate_background(capture_folder(background, later, []), BASE)
    assert "new_dust" in {remark.code for remark in result.remarks}
    truth = np.abs(dusty - gel())[..., 0] > 20
    assert (result.new_dust & truth).sum() > 0.8 * truth.sum()
    assert result.new_dust.mean() < 6 * truth.mean()
    assert speck_count(dust_mask(quantise(add_noise(gel(), 1.0, rng)))) == 0


def test_refusals() -> None:
    with pytest.raises(InputError, match="neither an untouched image nor presses"):
        calibrate_background(capture_folder(None, [], []), BASE)
    small = np.zeros((40, 50, 3), np.uint8)
    with pytest.raises(InputError, match="several sizes"):
        calibrate_background(capture_folder(quantise(gel()), [small], []), BASE)
    result = calibrate_background(capture_folder(quantise(gel()), [], []), BASE)
    middle = {"center_u_px": 49.5, "center_v_px": 39.5}
    other = dataclasses.replace(GRID, width_px=100, height_px=80, **middle)
    unscaled = dataclasses.replace(result, mm_per_px=None)
    with pytest.raises(InputError, match="state no scale"):
        unscaled.apply_to(tiny_profile(other))
    assert result.apply_to(tiny_profile(other)).camera.width_px == 200
