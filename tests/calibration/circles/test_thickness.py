# SPDX-License-Identifier: Apache-2.0
"""Thickness of a gel by how it sinks around balls and by their travel, on drawn presses of known
gels and on real ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.base_profile import on_grid
from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.circles.ball_surface import ball_surface, layer_of, sunk_share
from taccel_lab.calibration.circles.thickness import GelThickness, gel_thickness, thickness_origin
from taccel_lab.calibration.pad import fitted_design
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.assumed import thickness_interval_mm
from taccel_lab.reading.bonded_layer import BondedLayer
from taccel_lab.signals.rest_surface import flat_rest
from tests.support import synthetic_presses as synthetic
from tests.support.synthetic_presses import BALL_RADIUS_MM, GRID, circles_of, flat_background
from tests.support.variants import variants

CIRCLES = [
    ContactCircle(55.0 + 10 * (k % 6), 48.0 + 7 * (k // 2), 10.0 + 0.9 * (k % 5)) for k in range(8)
]


def drawn(thickness_mm: float, circles: list[ContactCircle] = CIRCLES) -> CaptureSet:
    """Presses on a gel of this thickness, with their travel; colours go with the sine of the slope,
    and with depth."""
    rng, background = np.random.default_rng(3), flat_background()
    layer, images, depths = BondedLayer(thickness_mm, 0.46), [], []
    for circle in circles:
        surface = ball_surface(circle, BALL_RADIUS_MM, GRID, layer, flat_rest(GRID))
        depths.append(surface.depth_mm)
        image = background + synthetic.known_change(surface) + rng.normal(0, 1.0, background.shape)
        images.append(np.clip(image, 0, 255))
    captures = synthetic.memory_captures(
        circles, images, background, GRID, BALL_RADIUS_MM, "flat_pad"
    )
    presses = zip(captures.presses, depths, strict=True)
    return replace(captures, presses=tuple(replace(p, depth_mm=d) for p, d in presses))


def silent(captures: CaptureSet) -> CaptureSet:
    """Captures of which nobody knows the travel."""
    return replace(captures, presses=tuple(replace(p, depth_mm=None) for p in captures.presses))


def profile_of(captures: CaptureSet, **design: float) -> SensorProfile:
    return on_grid(fitted_design("flat_pad", captures.grid, design), captures.grid, {})


def thickness(
    captures: CaptureSet, profile: SensorProfile | None = None, *which: Any, **more: Any
) -> GelThickness | None:
    circles = circles_of(captures)
    profile = profile or profile_of(captures)
    return gel_thickness(captures, circles, [0.3] * len(circles), profile, *which, **more)


def told(captures: CaptureSet) -> GelThickness:
    found = thickness(captures)
    assert found is not None
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("thickness_mm", variants([4.0], [2.0, 4.0, 8.0, 12.0]))
def test_a_thickness_that_nobody_measured_is_fitted_with_its_interval(thickness_mm: float) -> None:
    captures = silent(drawn(thickness_mm))
    found = told(captures)
    low, high = found.interval_mm
    assert found.origin == "assumed" and low <= thickness_mm <= high, found.sentence()
    if thickness_mm < 6:  # Where the rings reach as far as the gel is thick.
        assert found.thickness_mm == pytest.approx(thickness_mm, rel=0.1)
        assert high < 1.9 * low
    profile = found.apply_to(profile_of(captures))
    assert profile.gel.thickness_mm == found.thickness_mm == layer_of(profile).thickness_mm
    assert thickness_interval_mm(profile.gel) == found.interval_mm
    assert thickness_origin(profile) == "fitted" and profile.gel.provenance.kind == "calibrated"
    # What it does not know is in the depth: as far as depths differ over the interval.
    assert 0.01 < sunk_share(found.interval_mm, 1.2, BALL_RADIUS_MM, layer_of(profile)) < 0.08
    # Who calibrates another block with it does not fit it again.
    assert thickness(captures, profile) is None


@pytest.mark.thorough
def test_a_stated_thickness_that_is_wrong_by_three_times_blocks_or_is_fitted() -> None:
    captures, thick = silent(drawn(4.0)), silent(drawn(12.0))
    for stated in (1.35, 12.0):
        wrong = profile_of(captures, thickness_mm=stated)
        with pytest.raises(InputError, match=rf"{stated:g} mm of gel are stated.*--thickness fit"):
            thickness(captures, wrong)
    found = thickness(captures, wrong, "fit")
    assert found is not None and found.thickness_mm == pytest.approx(4.0, rel=0.1)
    # 4 mm are the catalogue's own figure: captures that state it say so beside the profile.
    assert thickness(captures, stated=True) is None
    with pytest.raises(InputError, match="4 mm of gel are stated"):
        thickness(thick, stated=True)


@pytest.mark.thorough
@pytest.mark.parametrize("thickness_mm", [3.0, 8.0])
def test_travel_of_presses_settles_a_thickness_that_images_leave_open(thickness_mm: float) -> None:
    """Three presses are too few for rings; how deep they are says it."""
    captures = drawn(thickness_mm, CIRCLES[:3])
    alone, found = told(silent(captures)), told(captures)
    assert alone.by_rings is None and not alone.fitted
    assert alone.interval_mm[1] > 5 * alone.interval_mm[0]
    low, high = found.interval_mm
    assert low <= thickness_mm <= high and found.travels == 3, found.sentence()
    assert found.fitted and high / low < 0.6 * alone.interval_mm[1] / alone.interval_mm[0]


@pytest.mark.thorough
def test_circles_that_are_off_keep_the_gel_in_the_interval() -> None:
    captures, rng = silent(drawn(3.0)), np.random.default_rng(5)
    moved = [
        ContactCircle(*(np.array([c.u_px, c.v_px, c.radius_px]) + rng.normal(0, 1, 3)))
        for c in CIRCLES
    ]
    found = gel_thickness(captures, moved, [0.3] * 8, profile_of(captures))
    assert found is not None and found.interval_mm[0] <= 3.0 <= found.interval_mm[1]


@pytest.mark.thorough
@pytest.mark.parametrize("what", ["noise", "no layer"])
def test_pictures_that_no_layer_explains_tell_no_thickness(what: str) -> None:
    """What is left open is as few as gels are, and a stated thickness is not contradicted."""
    captures, rng = silent(drawn(3.0)), np.random.default_rng(1)
    images = [captures.background + rng.normal(0, 1, captures.background.shape) for _ in CIRCLES]
    if what == "no layer":  # Slopes that grow with the distance from the ball.
        v, u = np.mgrid[: GRID.height_px, : GRID.width_px]
        for image, c in zip(images, CIRCLES, strict=True):
            away = np.hypot(u - c.u_px, v - c.v_px) / c.radius_px
            lean = np.where(away < 1, away, 0.2 * away)
            image[..., 0] += 40 * lean * np.cos(np.arctan2(v - c.v_px, u - c.u_px))
    spoilt = synthetic.with_images(captures, images)
    found = told(spoilt)
    assert not found.fitted and found.interval_mm[1] > 5 * found.interval_mm[0]
    stated = profile_of(spoilt, thickness_mm=1.5)
    assert thickness(spoilt, stated) is None
    with pytest.raises(InputError, match="nothing tells how thick"):
        thickness(spoilt, stated, "fit")


@pytest.mark.thorough
def test_the_taxim_gelsight_is_no_half_space(taxim_captures: CaptureSet) -> None:
    """Real presses, as on a flat gel: light around the dent turns once over about three radii, as
    over 4 to 6 mm."""
    found = told(replace(taxim_captures, sensor="flat_pad"))
    assert 3 < found.interval_mm[0] < found.thickness_mm < found.interval_mm[1] < 8, found
