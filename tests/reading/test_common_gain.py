# SPDX-License-Identifier: Apache-2.0
"""Light that changes in all channels alike is found, taken off and said; presses have none."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.reading.common_gain import CommonGain, common_gain
from taccel_lab.reading.light import fit_light
from taccel_lab.signals.frame_operators import bands, wear


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
        left = found.factor[:, 0] - true
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
    left = worn / found.factor[..., None] - rest
    assert np.abs(left).mean() < 0.2 * np.abs(worn - rest).mean() + 0.6


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
