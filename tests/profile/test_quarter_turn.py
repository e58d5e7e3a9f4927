# SPDX-License-Identifier: Apache-2.0
"""A sensor that is turned shows the same picture, turned."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.profile import SensorProfile
from taccel_lab.profile.quarter_turn import quarter_turned
from taccel_lab.sensors.profile import catalogue_profile


def turned_xyz(points: np.ndarray) -> np.ndarray:
    """Gel points after the turn: right becomes down."""
    return np.stack([-points[..., 1], points[..., 0], points[..., 2]], axis=-1)


@pytest.fixture(scope="module")
def tilted() -> SensorProfile:
    """A Mini with everything off centre, and a lens with tangential distortion."""
    profile = catalogue_profile("gelsight_mini")
    assert profile.optics is not None
    camera = profile.camera.replace(mm_per_px_y=1.1 * profile.camera.mm_per_px_x)
    return profile.with_block(camera).with_block(
        profile.optics.replace(
            crop_x=0.9,
            crop_y=0.8,
            fy_px=300.0,
            cx_px=150.0,
            cy_px=125.0,
            distortion=(0.05, -0.02, 0.004, -0.007, 0.01),
            position_mm=(0.7, -0.4, -24.0),
            rotation=(0.02, -0.03, 0.05, float(np.sqrt(1 - 0.0038))),
            raw_width_px=3280,
            raw_height_px=2464,
        )
    )


def pixels_of(profile: SensorProfile, points_mm: np.ndarray) -> np.ndarray:
    import cv2

    assert profile.optics is not None
    camera = profile.optics.camera()
    rotation = camera.gel_from_camera().T
    matrix = np.array(
        [[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]]
    )
    found, _ = cv2.projectPoints(
        points_mm,
        cv2.Rodrigues(rotation)[0],
        -rotation @ np.array(camera.position_mm),
        matrix,
        np.array(camera.distortion),
    )
    return found[:, 0]


def test_the_picture_turns(tilted: SensorProfile) -> None:
    after = quarter_turned(tilted)
    assert tilted.optics is not None and after.optics is not None
    points = np.random.default_rng(0).uniform(-6, 6, (20, 3)) * (1, 1, 0.1)
    before_px, after_px = pixels_of(tilted, points), pixels_of(after, turned_xyz(points))
    expected = np.stack([tilted.optics.height_px - 1 - before_px[:, 1], before_px[:, 0]], axis=1)
    assert after_px == pytest.approx(expected, abs=1e-9)
    assert (after.optics.width_px, after.optics.height_px) == (240, 320)
    assert (after.optics.raw_width_px, after.optics.raw_height_px) == (2464, 3280)
    assert (after.optics.crop_x, after.optics.crop_y) == (0.8, 0.9)
    grid, turned = tilted.grid(), after.grid()
    at = grid.pixel_from_gel(points[:, :2])
    assert turned.pixel_from_gel(turned_xyz(points)[:, :2]) == pytest.approx(
        np.stack([grid.height_px - 1 - at[:, 1], at[:, 0]], axis=1)
    )


def test_every_part_turns_with_it(tilted: SensorProfile) -> None:
    after = quarter_turned(tilted)
    assert after.mesh.nodes_m == pytest.approx(turned_xyz(tilted.mesh.nodes_m))
    assert tilted.lights is not None and after.lights is not None
    for before_led, led in zip(tilted.lights.led, after.lights.led, strict=True):
        assert led.position_mm == pytest.approx(turned_xyz(np.array(before_led.position_mm)))
        assert led.direction == pytest.approx(turned_xyz(np.array(before_led.direction)))
    assert tilted.markers is not None and after.markers is not None
    dots = np.pad(tilted.markers.grid().points_mm(), ((0, 0), (0, 1)))
    assert after.markers.grid().points_mm() == pytest.approx(turned_xyz(dots)[:, :2])
    assert tilted.housing is not None and after.housing is not None
    assert after.housing.size_mm[:2] == tilted.housing.size_mm[1::-1]
    assert after.window is not None and tilted.window is not None
    assert after.window.size_mm == tilted.window.size_mm[::-1]


def test_four_turns_are_none(tilted: SensorProfile) -> None:
    after = tilted
    for _ in range(4):
        after = quarter_turned(after)
    assert after.mesh.nodes_m == pytest.approx(tilted.mesh.nodes_m)
    for key, block in tilted.blocks().items():
        values, again = block.model_dump(), after.blocks()[key].model_dump()
        assert set(values) == set(again)
        for name in ("position_mm", "rotation", "distortion", "offset_mm", "rotation_deg", "cx_px"):
            if name in values:
                assert again[name] == pytest.approx(values[name]), (key, name)
