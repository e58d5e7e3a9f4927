# SPDX-License-Identifier: Apache-2.0
"""A surface that is read from a smaller image is the same surface."""

from __future__ import annotations

import pytest

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.normals.read_surface import SurfaceReader
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.surfaces import PressSurface
from tests.calibration.normals.test_normals import clean  # noqa: F401
from tests.support.synthetic_presses import GRID, flat_profile


def test_a_smaller_image_gives_the_same_depth_at_the_same_place(
    clean: tuple[CaptureSet, list[PressSurface], NormalCalibration],  # noqa: F811
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
