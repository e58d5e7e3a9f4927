# SPDX-License-Identifier: Apache-2.0
"""Light that changes in all channels alike is found, taken off and said; presses have none."""

from __future__ import annotations

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.files.images import read_image
from taccel_lab.reading.common_gain import CommonGain, common_gain
from taccel_lab.reading.light import fit_light
from taccel_lab.signals.frame_operators import bands, wear
from tests.support.real_data import real_data


def found_in(image: np.ndarray, rest: np.ndarray, seed: int = 0) -> CommonGain | None:
    noise = np.random.default_rng(seed).normal(0.0, 1.2, image.shape)
    levels, rest = np.rint(image + noise).astype(np.float32), rest.astype(np.float32)
    return common_gain(fit_light(levels, rest).remove(levels), rest)


@pytest.mark.parametrize("depth", [0.01, 0.03, 0.06])
@pytest.mark.parametrize("periods", [2.1, 3.0, 6.2])
def test_bands_are_found_to_a_sixth(
    taxim_captures: CaptureSet, depth: float, periods: float
) -> None:
    rest = taxim_captures.background.astype(float)
    press = taxim_captures.presses[5].image().astype(float)
    for image in (rest, press) if depth > 0.01 else (rest,):
        found = found_in(bands(image, depth, periods, 0.21), rest)
        assert found is not None and "goes up and down along the rows" in found.remark
        rows = np.arange(len(rest)) / len(rest)
        true = 1.0 + depth * np.sin(2.0 * np.pi * (periods * rows + 0.21))
        # What is linear over the image is its light's gradient.
        lines = np.vander(rows, 2)
        left = found.factor[:, 0, 0] - true
        left -= lines @ np.linalg.lstsq(lines, left, rcond=None)[0]
        assert np.abs(left).max() < max(depth / 6, 0.0015)


@pytest.mark.parametrize("gain", [0.03, 0.06, 0.15, -0.08])
@pytest.mark.parametrize("place", [((0.0, 0.0), 0.3), ((0.4, -0.25), 0.1)])
def test_a_worn_patch_is_taken_off(
    taxim_captures: CaptureSet, gain: float, place: tuple[tuple[float, float], float]
) -> None:
    rest = taxim_captures.background.astype(float)
    worn = wear(rest, gain, *place)
    found = found_in(worn, rest)
    assert found is not None and "the background is old" in found.remark
    assert ("brighter" if gain > 0 else "darker") in found.remark
    left = worn / found.factor - rest
    assert np.abs(left).mean() < 0.2 * np.abs(worn - rest).mean() + 0.6


def darker_corners(image: np.ndarray, share: float) -> np.ndarray:
    """An image whose corners have become darker by ``share``, as another lens makes them."""
    v, u = np.mgrid[-1 : 1 : image.shape[0] * 1j, -1 : 1 : image.shape[1] * 1j]
    return image * (1.0 - share * ((u**2 + v**2) / 2) ** 2)[..., None]


def toned(image: np.ndarray, gamma: float) -> np.ndarray:
    """An image of a camera with another tone curve."""
    return 255.0 * (image / 255.0) ** gamma


SHADES = {
    "corners 10 % darker": (lambda image: darker_corners(image, 0.1), "corners and middle"),
    "corners 25 % darker": (lambda image: darker_corners(image, 0.25), "corners and middle"),
    "corners 15 % brighter": (lambda image: darker_corners(image, -0.15), "corners and middle"),
    "gamma 0.8": (lambda image: toned(image, 0.8), "tone curve"),
    "gamma 1.25": (lambda image: toned(image, 1.25), "tone curve"),
}


@pytest.mark.parametrize("name", SHADES)
@pytest.mark.parametrize("mini", ["gsmini_gs_sdk/examples/data", "gsmini_cube_edges"])
def test_an_untouched_mini_in_another_shade_or_tone_reads_zero(mini: str, name: str) -> None:
    """Before, corners 10 % darker read 1.0 N (0 to 3.8), a gamma of 1.2 0.16 N (0 to 0.65)."""
    rest = read_image(real_data(f"{mini}/background.png"))
    change, said = SHADES[name]
    noise = np.random.default_rng(3).normal(0.0, 1.0, rest.shape)
    image = np.clip(np.rint(change(rest.astype(float)) + noise), 0, 255).astype(np.uint8)
    found = tl.read("gelsight_mini", image, background=rest)
    assert not found.touch.any and found.force_interval_n is not None
    assert found.force_interval_n[0] == 0.0 and found.force_interval_n[1] < 0.2
    assert any(said in note for note in found.notes)


def test_presses_and_an_untouched_gel_have_none(taxim_captures: CaptureSet) -> None:
    rest = taxim_captures.background
    assert found_in(rest, rest) is None
    assert found_in(1.1 * rest.astype(float), rest) is None
    for k in (0, 5, 17, 40):
        assert found_in(taxim_captures.presses[k].image().astype(float), rest) is None


def test_lamps_of_one_colour_show_no_patch(taxim_captures: CaptureSet) -> None:
    """Each slope changes all channels alike there."""
    grey = np.repeat(taxim_captures.background.mean(axis=-1, keepdims=True), 3, axis=-1)
    assert found_in(wear(grey, 0.06, radius=0.3), grey) is None
