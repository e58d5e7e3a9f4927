# SPDX-License-Identifier: Apache-2.0
"""Backgrounds of many frames: noise, dust and stains."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from taccel_lab.calibration.background import result as background_result
from taccel_lab.calibration.background.fit import calibrate_background
from taccel_lab.calibration.background.result import BackgroundCalibration, dust_mask
from taccel_lab.calibration.capture import CapturedPress, CaptureFolder, ContactCircle, Frame
from taccel_lab.errors import InputError
from tests.calibration.circles.presses import BALL_MM, GRID, gel, pressed, scattered
from tests.calibration.drawn.faults import add_dust, add_noise, drift, poison, quantise
from tests.support.synthetic_presses import tiny_profile

Images = list[np.ndarray]


def calibrated(
    background: np.ndarray | None,
    untouched: Images,
    presses: Images,
    mask: np.ndarray | None = None,
) -> BackgroundCalibration:
    folder = in_memory(background, untouched, presses, mask)
    return calibrate_background(folder, tiny_profile(GRID))


def in_memory(
    background: np.ndarray | None,
    untouched: Images,
    presses: Images,
    mask: np.ndarray | None = None,
) -> CaptureFolder:
    def frame(name: str, image: np.ndarray) -> Frame:
        return Frame(name, name, "0" * 64, partial(np.copy, image))

    return CaptureFolder(
        source="memory", root=Path(), sensor="gelsight", unit=None,
        background=None if background is None else frame("background", background),
        untouched=tuple(frame(f"u{i}", image) for i, image in enumerate(untouched)),
        mask=mask, mm_per_px=(GRID.mm_per_px_x, GRID.mm_per_px_y), ball_radius_mm=BALL_MM,
        presses=tuple(CapturedPress(f"p{i}", f"p{i}", "1" * 64, partial(np.copy, image))
                      for i, image in enumerate(presses)),
    )  # fmt: skip


def codes(result: BackgroundCalibration) -> set[str]:
    return {remark.code for remark in result.remarks}


@pytest.mark.thorough
def test_average_is_quieter_and_keeps_no_stain() -> None:
    rng = np.random.default_rng(3)

    def seen(image: np.ndarray) -> np.ndarray:
        lit = drift(image, 1 + rng.normal(0, 0.03, 3), rng.normal(0, 3, 3))
        return quantise(add_noise(lit, 2.0, rng))

    presses = [seen(pressed(c)) for c in scattered(16, seed=1)]
    untouched = [seen(gel()) for _ in range(4)]
    background = quantise(add_noise(gel(), 2.0, rng))
    result = calibrated(background, untouched, presses)
    before, after = (np.sqrt(np.mean((image - gel()) ** 2)) for image in (background, result.image))
    assert after < 0.55 * before
    # Smoothed over 9 px, nothing of the presses is left.
    assert np.abs(uniform_filter(result.image - gel(), (9, 9, 1))).max() < 1.5
    assert result.noise_levels == pytest.approx(2.0, rel=0.2)
    assert result.spread is not None and result.spread.auto_white_balance
    assert result.figures()["heldout_l1"] < result.figures()["plain_l1"]
    block = result.apply_to(tiny_profile(GRID)).background
    assert block is not None and block.provenance.verdict == "usable"


@pytest.mark.thorough
def test_background_from_presses_alone() -> None:
    rng = np.random.default_rng(5)
    presses = [quantise(add_noise(pressed(c), 1.0, rng)) for c in scattered(14, seed=1)]
    result = calibrated(None, [], presses)
    assert np.abs(result.image - gel()).mean() < 1.5 and "no_untouched_image" in codes(result)
    with pytest.raises(InputError, match="too few to make one"):
        calibrated(None, [], presses[:3])
    with pytest.raises(InputError, match="spread over the gel"):
        # Eight times the same press, and eight of another: half touch each place.
        calibrated(None, [], [*presses[:1] * 8, *presses[1:2] * 8])


def test_masked_pixels_have_no_effect() -> None:
    rng = np.random.default_rng(6)
    mask = np.ones((150, 200), dtype=bool)
    mask[20:60, 30:90] = False
    images = [quantise(add_noise(gel(), 1.5, rng)) for _ in range(4)]
    spoilt = [quantise(poison(image, mask, rng)) for image in images]
    first, second = (calibrated(images[0], some[1:], [], mask) for some in (images, spoilt))
    assert np.array_equal(first.image, second.image)
    assert first.figures()["drift"] == second.figures()["drift"]


@pytest.mark.thorough
def test_a_background_with_a_contact_in_it_is_weak() -> None:
    rng = np.random.default_rng(8)
    circles = [c for c in scattered(14, seed=3) if np.hypot(c.u_px - 150, c.v_px - 50) > 40]
    presses = [quantise(add_noise(pressed(circle), 1.5, rng)) for circle in circles]
    spoilt = quantise(add_noise(pressed(ContactCircle(150.0, 50.0, 20.0)), 1.5, rng))
    found = calibrated(spoilt, [], presses)
    assert "background_pressed" in codes(found) and found.figures()["verdict"] == "weak"
    # Nothing is said of what the mask hides, whatever the light does.
    mask = np.ones((150, 200), dtype=bool)
    mask[20:80, 118:182] = False
    warmer = [quantise(poison(drift(p, np.ones(3), np.full(3, 25.0)), mask, rng)) for p in presses]
    assert "background_pressed" not in codes(calibrated(spoilt, [], warmer, mask))


def test_dust_that_stays() -> None:
    rng = np.random.default_rng(7)
    dusty = add_dust(gel(), 12, np.random.default_rng(1), radius_px=1.5)
    background = quantise(add_noise(gel(), 1.0, rng))
    result = calibrated(background, [quantise(add_noise(dusty, 1.0, rng)) for _ in range(4)], [])
    assert "new_dust" in codes(result)
    truth = np.abs(dusty - gel())[..., 0] > 20
    assert (result.new_dust & truth).sum() > 0.8 * truth.sum()
    assert result.new_dust.mean() < 6 * truth.mean()
    assert background_result.speck_count(dust_mask(quantise(add_noise(gel(), 1.0, rng)))) == 0


def test_frames_of_a_folder_are_compared_once() -> None:
    """Colours and normals are fitted against the background that its own block has found."""
    image, rng = gel(), np.random.default_rng(0)
    folder = in_memory(image, [add_noise(image, 1.0, rng) for _ in range(2)], [])
    told: list[int] = []
    first, again = (
        calibrate_background(folder, tiny_profile(GRID), progress=lambda *_: told.append(1))
        for _ in range(2)
    )
    assert again is first and len(told) == 3


def test_refusals() -> None:
    with pytest.raises(InputError, match="neither an untouched image nor presses"):
        calibrated(None, [], [])
    with pytest.raises(InputError, match="several sizes"):
        calibrated(quantise(gel()), [np.zeros((40, 50, 3), np.uint8)], [])
    result = calibrated(quantise(gel()), [], [])
    middle = {"center_u_px": 49.5, "center_v_px": 39.5}
    other = tiny_profile(replace(GRID, width_px=100, height_px=80, **middle))
    with pytest.raises(InputError, match="state no scale"):
        replace(result, mm_per_px=None).apply_to(other)
    assert result.apply_to(other).camera.width_px == 200
