# SPDX-License-Identifier: Apache-2.0
"""Thickness of a gel by how it sinks around balls, on drawn presses of known gels and real ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.normals.samples import InverseFrame, Scene
from taccel_lab.calibration.normals.skirt import ball_surface
from taccel_lab.calibration.normals.told_thickness import (
    THICKEST_MM,
    ToldThickness,
    told_thickness,
)
from taccel_lab.calibration.surfaces.bonded_layer import BondedLayer
from taccel_lab.signals.normals import normals_from_height
from taccel_lab.signals.rest_surface import flat_rest
from tests.support.synthetic_presses import BALL_RADIUS_MM, GRID, flat_background, known_change

NU = 0.46
CIRCLES = [
    ContactCircle(55.0 + 10 * (k % 6), 48.0 + 7 * (k // 2), 10.0 + 0.9 * (k % 5)) for k in range(8)
]


def drawn(thickness_mm: float, *, noise: float = 1.0) -> tuple[list[InverseFrame], Scene]:
    """Presses on a gel of this thickness; colours go with the sine of the slope, and with depth."""
    rng = np.random.default_rng(3)
    background = flat_background().astype(np.float32)
    layer, frames = BondedLayer(thickness_mm, NU), []
    for circle in CIRCLES:
        surface = ball_surface(circle, BALL_RADIUS_MM, GRID, layer, flat_rest(GRID))
        image = background + known_change(surface) + rng.normal(0, noise, background.shape)
        frames.append(InverseFrame("press", np.clip(image, 0, 255).astype(np.float32), circle, ""))
    return frames, Scene(background, GRID, BALL_RADIUS_MM)


def told(frames: list[InverseFrame], scene: Scene, stated_mm: float) -> ToldThickness:
    found = told_thickness(frames, scene, BondedLayer(stated_mm, NU))
    assert found is not None
    return found


@pytest.mark.parametrize(("thickness_mm", "width"), [(2.0, 1.3), (3.0, 1.3), (5.0, 1.7)])
def test_a_gel_of_known_thickness_is_told_whatever_is_stated(
    thickness_mm: float, width: float
) -> None:
    """To within a few percent; less well, the fewer contact radii are as wide as it is thick."""
    frames, scene = drawn(thickness_mm)
    for stated_mm in (2.5, 9.0):
        found = told(frames, scene, stated_mm)
        assert found.low_mm / 1.05 <= thickness_mm <= found.high_mm * 1.05, found
        assert found.high_mm < width * found.low_mm, found
    # A thick gel's rim sinks further: the same circles are deeper there than in the stated one.
    assert told(frames, scene, 9.0).depth_high < 1 < told(frames, scene, 1.5).depth_low


def test_a_half_space_is_thick_as_far_as_can_be_told() -> None:
    frames, scene = drawn(40.0)
    found = told(frames, scene, 4.0)
    assert found.low_mm > 5 and found.high_mm > 0.95 * THICKEST_MM, found
    assert found.depth_low > 1.05, found


def test_circles_that_are_off_widen_the_interval_and_keep_the_gel() -> None:
    frames, scene = drawn(3.0)
    rng = np.random.default_rng(5)
    sharp = told(frames, scene, 3.0)
    moved = []
    for frame in frames:
        du, dv, dr = rng.normal(0, 1, 3)
        c = frame.circle
        off = ContactCircle(c.u_px + du, c.v_px + dv, c.radius_px + dr)
        moved.append(replace(frame, circle=off))
    found = told(moved, scene, 3.0)
    assert found.high_mm - found.low_mm > sharp.high_mm - sharp.low_mm
    assert found.low_mm / 1.1 <= 3.0 <= found.high_mm * 1.1, found


def test_nothing_is_told_of_curved_gels_and_of_contacts_that_fill_the_picture() -> None:
    frames, scene = drawn(3.0)
    v, u = np.mgrid[: GRID.height_px, : GRID.width_px]
    dome = -1e-3 * 0.1**2 * ((u - 80.0) ** 2 + (v - 60.0) ** 2) / (2 * 20.0)
    domed = replace(scene, rest_normals=normals_from_height(dome, GRID))
    assert told_thickness(frames, domed, BondedLayer(3.0, NU)) is None
    wide = [replace(f, circle=replace(f.circle, radius_px=26.0)) for f in frames]
    assert told_thickness(wide, scene, BondedLayer(3.0, NU)) is None
    assert told_thickness(frames[:3], scene, BondedLayer(3.0, NU)) is None


def test_grey_noise_tells_nothing_of_a_gel() -> None:
    """Pictures without any dent: the interval, if there is one, leaves everything open."""
    _, scene = drawn(3.0)
    rng = np.random.default_rng(1)
    blank = [
        InverseFrame("x", scene.background + rng.normal(0, 1, scene.background.shape), c, "")
        for c in CIRCLES
    ]
    found = told_thickness(blank, scene, BondedLayer(3.0, NU))
    assert found is None or found.high_mm > 2 * found.low_mm


def test_the_taxim_gelsight_is_no_half_space(taxim_captures: CaptureSet) -> None:
    """Real presses: light around the dent turns once over about three radii, as over 4 to 6 mm."""
    mask = None if taxim_captures.mask.all() else taxim_captures.mask
    scene = Scene(
        taxim_captures.background.astype(np.float32),
        taxim_captures.grid,
        taxim_captures.ball_radius_mm,
        mask,
    )
    frames = [
        InverseFrame(press.name, press.image().astype(np.float32), press.circle, "")
        for press in taxim_captures.presses
        if press.circle is not None
    ]
    found = told(frames, scene, 4.0)
    assert 3 < found.low_mm < found.high_mm < 8, found
