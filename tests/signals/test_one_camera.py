# SPDX-License-Identifier: Apache-2.0
"""Markers, heights and points lie where the picture of the same sensor shows them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.ndimage import binary_erosion

from taccel_lab.camera.gel_camera import GelCamera, camera_of
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.optics.render import OpticalModel
from taccel_lab.profile import Provenance, SensorProfile
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.signals import MarkerLayout, SignalTactile
from tests.signals.find_dots import distances_px, find_dots
from tests.signals.tactile_cases import DEVICES, on_device
from tests.support.dotted_profiles import with_painted_dots
from tests.support.variants import variants

DOTS: dict[str, dict[str, Any]] = {
    "gelsight_mini": {},
    "gelsight_40": {},
    "digit": {"marker_pitch_mm": 2.0, "marker_area_x_mm": 10.0, "marker_area_y_mm": 12.0},
    "rtac": {"marker_pitch_mm": 3.0, "marker_area_x_mm": 18.0, "marker_area_y_mm": 18.0},
}
"""Sensors with dots: curved and flat gels, a distorted lens, a camera aside and under a dome."""


def states_of(profile: SensorProfile) -> np.ndarray:
    """Nodes [m] of the gel at rest, and pushed in by 1 mm off its middle, dragged by 0.4 mm."""
    rest = profile.mesh.nodes_m
    x, y, z = rest.T
    share = (z - z.min()) / np.ptp(z)
    dent = 1e-3 * share * np.exp(-((x - 2e-3) ** 2 + (y - 1e-3) ** 2) / 4e-3**2)
    return np.stack([rest, rest + np.stack([0.4e-3 * share, 0 * share, -dent], axis=1)])


def painted(profile: SensorProfile) -> SensorProfile:
    """With dots on the pixel grid: what a calibration gives."""
    places = profile.grid().pixel_from_gel(profile.markers.grid().points_mm())
    return with_painted_dots(profile, places, radius_px(profile))


def radius_px(profile: SensorProfile) -> float:
    return profile.markers.radius_mm / profile.camera.mm_per_px_x


@pytest.mark.thorough
@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", variants(["gelsight_mini", "digit"], DOTS))
def test_signals_lie_where_the_optical_model_shows_them(name, device):
    profile = catalogue_profile(name, DOTS[name])
    dots, states = profile.markers.grid(), states_of(profile)
    model = OpticalModel(profile.optical_design(), profile.mesh, markers=dots)
    signal = SignalTactile.from_profile(profile, env_count=2, device=device)
    signal.update(on_device(states, device))
    names = ("markers_px", "points_m", "normals", "depth_m")
    places, points, normals, depth = (array.numpy() for array in signal.read(*names))
    assert np.nanmax(np.abs(depth[0])) == 0
    layout = MarkerLayout.where_on(profile.mesh, dots.points_mm())[0]
    for row, picture in enumerate(map(model.render, states)):
        found = find_dots(picture.rgb, radius_px(profile))
        assert len(found) >= 0.9 * len(places[row])
        off = distances_px(found, places[row])
        assert off.mean() < 0.1 and off.max() < 0.3
        along = profile.grid().pixel_from_gel(layout.places_mm(states[row]))
        assert distances_px(found, along).mean() > 1.5, "a view along the normal misses them"
        both = picture.mask & np.isfinite(points[row]).all(axis=-1)
        # Of a dome that is dragged aside, the far flank hangs over.
        assert both.sum() > (0.95 if name == "rtac" else 0.99) * picture.mask.sum()
        apart_mm = np.linalg.norm(1e3 * points[row] - picture.points_mm, axis=-1)
        # Beside an edge that hides the face one of the two may just see past it.
        clear = binary_erosion(both | ~picture.mask, iterations=3) & both
        assert clear.sum() > 0.9 * both.sum()
        assert np.quantile(apart_mm[clear], 0.99) < 0.02
        turned = np.einsum("pi,pi->p", normals[row][both], picture.normals[both])
        # The two rebuild the face between coarse nodes in ways of their own.
        assert np.median(turned) > np.cos(np.radians(0.5))


@pytest.mark.thorough(cases=("gelsight_40",))
@pytest.mark.parametrize("name", ["gelsight_mini", "gelsight_40"])
def test_dots_of_a_colour_model_lie_where_the_markers_are(name):
    profile = painted(catalogue_profile(name))
    assert camera_of(profile) == profile.grid()
    signal = SignalTactile.from_profile(profile, env_count=2)
    signal.update(wp.array(states_of(profile), dtype=wp.vec3d))
    rgb, places = (array.numpy() for array in signal.read("rgb", "markers_px"))
    for picture, expected in zip(rgb, places, strict=True):
        found = find_dots(picture, radius_px(profile))
        assert len(found) >= 0.9 * len(expected)
        assert distances_px(found, expected).mean() < 0.3


def test_camera_that_a_profile_has():
    profile = catalogue_profile("gelsight_mini")
    assert camera_of(profile).camera == profile.optical_design().camera
    assert camera_of(profile.without("optics")) == profile.grid()
    # A measured scale rules over the optics of another unit: straight, at the scale of the grid.
    old = profile.camera
    scale = {key: 1.1 * getattr(old, key) for key in ("mm_per_px_x", "mm_per_px_y")}
    measured = Provenance(kind="measured", method="made up", source="tests")
    wider = old.replace(**scale, provenance=measured)
    straight = camera_of(profile.with_block(wider))
    apex = np.array([[0.0, 0.0, 0.0], [2.0, -1.0, 0.0]])
    np.testing.assert_allclose(straight.pixel_from_gel(apex), wider.grid().pixel_from_gel(apex))
    lifted = straight.pixel_from_gel(apex + [0, 0, -1.0])[1] - straight.pixel_from_gel(apex[1])
    assert lifted[0] > 0.5 and lifted[1] < -0.2, "a press moves what it shows outwards"


@pytest.mark.thorough(cases=("gelsight_40", "rtac"))
@pytest.mark.parametrize("name", DOTS)
def test_cameras_are_kept_as_json_and_scaled(name):
    profile = catalogue_profile(name, DOTS[name])
    camera, before = camera_of(profile), profile.grid()
    points = np.random.default_rng(2).uniform(-3, 3, (40, 3)) * [1, 1, 0.1]
    there = camera.pixel_from_gel(points)
    again = GelCamera.of_record(camera.record())
    np.testing.assert_array_equal(again.pixel_from_gel(points), there)
    half = camera.resized(camera.width_px // 2, camera.height_px // 2)
    np.testing.assert_allclose(half.pixel_from_gel(points), (there + 0.5) / 2 - 0.5, atol=1e-9)
    size = (before.width_px, before.height_px)
    scale = (0.9 * before.mm_per_px_x, before.mm_per_px_y)
    after = PixelGrid(*size, *scale, before.center_u_px + 3, before.center_v_px)
    moved = camera.regridded(before, after).pixel_from_gel(points)
    expected = after.pixel_from_gel(before.gel_from_pixel(there))
    np.testing.assert_allclose(moved, expected, atol=1e-9)


def test_colours_take_no_perspective_camera():
    profile = painted(catalogue_profile("gelsight_mini"))
    model = SignalTactile.from_profile(profile, env_count=1)._color[0]
    options = {"color_model": model, "background_rgb": profile.background_rgb}
    with pytest.raises(InputError, match="pixel grid"):
        SignalTactile(profile.mesh, camera_of(profile.without("color")), env_count=1, **options)
