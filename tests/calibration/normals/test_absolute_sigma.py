# SPDX-License-Identifier: Apache-2.0
"""The +- of depths holds what the calibration was told wrong; smaller images, the same depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.normals.read_surface import SurfaceReader
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.surfaces import PressSurface
from taccel_lab.calibration.surfaces.ball_in_layer import layer_skirts
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.read_heights import BAND_SIGMAS, ReadHeights, read_heights
from taccel_lab.signals.rest_surface import flat_rest
from tests.calibration.normals.conftest import (
    PAD,
    QUICK,
    Clean,
    calibrated,
    circles_of,
    sunk_captures,
)
from tests.support.synthetic_presses import GRID, flat_profile

pytestmark = pytest.mark.usefixtures("one_thread")
Known = tuple[CaptureSet, list[PressSurface]]


def told(known: Known, radius_px: float, scale_share: float) -> NormalCalibration:
    """A calibration on circles that are all too wide and on a scale that is too large, by what it
    is told that they may be."""
    mm_per_px = (1 + scale_share) * GRID.mm_per_px_x
    captures = replace(
        known[0], grid=PixelGrid(GRID.width_px, GRID.height_px, mm_per_px, mm_per_px)
    )
    presses = tuple(
        replace(press, circle=replace(circle, radius_px=circle.radius_px + radius_px))
        for press, circle in zip(captures.presses, circles_of(captures), strict=True)
    )
    captures = replace(captures, presses=presses)
    surfaces = layer_skirts(captures, circles_of(captures), PAD, flat_rest(captures.grid))
    count = len(captures.split(4).train)
    return calibrated(
        captures, surfaces, options=replace(QUICK, practice=24), pad=PAD,
        circle_sigmas_px=[(0.0, radius_px)] * count, scale_share=scale_share,
    )  # fmt: skip


def readings(result: NormalCalibration, known: Known) -> list[tuple[ReadHeights, np.ndarray]]:
    """Held-out presses as they are read, and their true rise [m]."""
    captures, surfaces = known
    found = []
    for i in captures.split(4).heldout:
        image = captures.presses[i].image().astype(np.float32)
        read = read_heights(result.fit.model, image, captures.background, result.scene.grid)
        found.append((read, 1e-3 * surfaces[i].displacement_mm()))
    return found


def held(found: Sequence[tuple[ReadHeights, np.ndarray]], *, alone: bool = False) -> float:
    """Share of the dents within two standard deviations."""
    shares = []
    for read, rise_m in found:
        sigma_m = read.reading_sigma_m if alone else read.sigma_m
        assert sigma_m is not None
        dent = rise_m < 0.3 * rise_m.min()
        shares.append(np.mean(np.abs(read.rise_m - rise_m)[dent] <= BAND_SIGMAS * sigma_m[dent]))
    return float(np.mean(shares))


def share_of_depth(found: Sequence[tuple[ReadHeights, np.ndarray]]) -> float:
    """Mean standard deviation of the deepest points over their depth."""
    shares = []
    for read, _ in found:
        assert read.sigma_m is not None
        deepest = np.unravel_index(int(np.argmin(read.rise_m)), read.rise_m.shape)
        shares.append(-read.sigma_m[deepest] / read.rise_m[deepest])
    return float(np.mean(shares))


@pytest.fixture(scope="module")
def known() -> Known:
    return sunk_captures()


@pytest.mark.parametrize(
    ("radius_px", "scale_share"),
    [
        pytest.param(1.2, 0.0, id="circles"),
        pytest.param(0.0, 0.05, id="scale", marks=pytest.mark.slow),
    ],
)
def test_what_is_wrong_as_stated_is_held(
    known: Known, radius_px: float, scale_share: float
) -> None:
    found = readings(told(known, radius_px, scale_share), known)
    assert held(found, alone=True) < 0.5
    assert held(found) > 0.93
    # Wide enough, and not silly.
    off = np.mean([np.abs(read.rise_m.min() / rise_m.min() - 1) for read, rise_m in found])
    assert off < 2 * share_of_depth(found) < 5 * off


def test_a_smaller_image_gives_the_same_depth_at_the_same_place(
    clean: Clean,
) -> None:
    captures, _, result = clean
    profile = result.apply_to(flat_profile(GRID))
    image = captures.presses[captures.split(4).heldout[0]].image()
    whole, half = SurfaceReader(profile), SurfaceReader(profile, shrink=2)
    assert half.grid.width_px == pytest.approx(GRID.width_px / 2, abs=2)
    fine, coarse = whole.read(image), half.read(image)
    assert coarse.rise_m.shape == (half.grid.height_px, half.grid.width_px)
    assert coarse.rise_m.min() == pytest.approx(fine.rise_m.min(), rel=0.03)
    a, b = fine.figures(whole.grid), coarse.figures(half.grid)
    assert b["deepest_gel_mm"] == pytest.approx(a["deepest_gel_mm"], abs=0.25)
    quick = half.read_levels(half.in_own_light(image), uncertainty=False)
    assert quick.height_sigma_m is None and (quick.rise_m == coarse.rise_m).all()
