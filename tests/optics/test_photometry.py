# SPDX-License-Identifier: Apache-2.0
"""Photometric figures of designs whose figures are known."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.optics.photometry import (
    blur_px,
    channel_independence,
    measure_photometry,
    pixel_footprint,
    sharp_range_mm,
)
from taccel_lab.profile.optical_design import Coating, Light, MarkerGrid
from tests.optics.flat_gel import CAMERA_Z, GEL_MM, PLATE, camera, design, model, towards

FAR = 4000.0
COLORS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def far_lights(azimuths: tuple[float, ...], elevation: float) -> tuple[Light, ...]:
    """Lights so far away that each shines from one direction, one channel each."""
    return tuple(
        Light(*towards(azimuth, elevation, FAR), color)
        for azimuth, color in zip(azimuths, COLORS, strict=False)
    )


@pytest.mark.parametrize("elevation", [25.0, 35.2644, 60.0])
def test_three_lights_at_120_degrees(elevation):
    """Unit rows at elevation e have the singular values cos(e) sqrt(3/2), twice, and sin(e)
    sqrt(3)."""
    lights = far_lights((0.0, 120.0, 240.0), elevation)
    figures = measure_photometry(model(design(*lights), refraction=False))
    e = math.radians(elevation)
    sides = (math.cos(e) * math.sqrt(1.5), math.sin(e) * math.sqrt(3))
    assert figures.light_rank == 3
    assert figures.condition_number is not None
    assert figures.condition_number.median == pytest.approx(max(sides) / min(sides), rel=2e-3)
    assert figures.condition_number.maximum == pytest.approx(
        figures.condition_number.minimum, rel=0.03
    )


@given(matrix=st.lists(st.floats(-1, 1), min_size=9, max_size=9), gain=st.floats(0.1, 10))
def test_condition_number_is_that_of_the_unit_rows(matrix, gain):
    rows = np.array(matrix).reshape(3, 3)
    lengths = np.linalg.norm(rows, axis=1)
    if lengths.min() < 1e-3 or np.linalg.svd(rows / lengths[:, None])[1][2] < 0.05:
        return
    expected = np.linalg.cond(rows / lengths[:, None])
    # The strength of a channel's light changes nothing.
    scaled = rows * np.array([[gain], [1.0], [1 / gain]])
    rank, condition = channel_independence(np.stack([scaled, scaled]))
    assert rank == 3
    assert condition is not None
    assert condition.median == pytest.approx(expected, rel=1e-6)


def test_sensors_without_three_directions_say_so():
    white = Light(*towards(0, 40, FAR), (1.0, 1.0, 1.0))
    grey = measure_photometry(model(design(white), refraction=False))
    assert grey.light_rank == 1
    assert grey.condition_number is None
    two = measure_photometry(model(design(*far_lights((0.0, 120.0), 40.0)), refraction=False))
    assert two.light_rank == 2
    assert two.condition_number is None
    # A channel that no light feeds is dark, not an error.
    assert math.isnan(two.uniformity_variation[2])
    assert two.to_json()["uniformity_variation"][2] is None
    assert json.loads(json.dumps(two.to_json()))["light_rank"] == 2


def test_scale_of_a_pinhole_over_a_flat_gel():
    lights = far_lights((0.0, 120.0, 240.0), 40.0)
    optics = replace(design(*lights), camera=camera(fy_px=75.0))
    straight = measure_photometry(model(optics, refraction=False))
    for spread, focal in ((straight.mm_per_px_x, 60.0), (straight.mm_per_px_y, 75.0)):
        assert spread.minimum == pytest.approx(-CAMERA_Z / focal, rel=1e-4)
        assert spread.maximum == pytest.approx(-CAMERA_Z / focal, rel=1e-4)
    assert straight.anisotropy.median == pytest.approx(75 / 60, rel=1e-3)
    # Window and gel shorten the distance that counts at the axis, and bend more off it.
    bent = measure_photometry(model(replace(optics, window=PLATE)))
    apparent = (-CAMERA_Z - 3.0 - GEL_MM) + 3.0 / 1.49 + GEL_MM / 1.41
    assert bent.mm_per_px_x.maximum == pytest.approx(apparent / 60.0, rel=1e-3)
    assert bent.mm_per_px_x.minimum < 0.999 * apparent / 60.0


def test_footprint_of_a_sheared_image():
    v, u = np.mgrid[:5, :6].astype(float)
    points = np.stack([0.2 * u + 0.1 * v, 0.3 * v, 0 * u], axis=-1)
    across, down, anisotropy = pixel_footprint(points)
    assert np.nanmax(across) == pytest.approx(0.2)
    assert np.nanmax(down) == pytest.approx(math.hypot(0.1, 0.3))
    sides = np.linalg.svd(np.array([[0.2, 0.0], [0.1, 0.3]]), compute_uv=False)
    assert np.nanmax(anisotropy) == pytest.approx(sides[0] / sides[1])
    assert np.isnan(across[:, 0]).all()


@pytest.mark.parametrize("half", [30.0, 6.0])
def test_visible_fraction(half):
    lights = far_lights((0.0, 120.0, 240.0), 40.0)
    optics = model(design(*lights), half=half, refraction=False, size_px=(164, 124))
    shown = 41 * 0.5 * 31 * 0.5
    expected = min(1.0, shown / (2 * half) ** 2)
    assert measure_photometry(optics).visible_fraction == pytest.approx(expected, rel=0.02)


def test_visible_part_of_a_dome():
    """A pinhole in the centre of a sphere sees R^2 times its rectangle's solid angle."""
    radius = 12.0

    def cap(xy):
        return np.sqrt(np.maximum(radius**2 - np.sum(xy**2, axis=-1), 0.04)) - radius

    lights = far_lights((0.0, 120.0, 240.0), 60.0)
    centred = camera(
        width_px=164, height_px=124, fx_px=120.0, fy_px=120.0, cx_px=81.5, cy_px=61.5,
        position_mm=(0.0, 0.0, -radius),
    )  # fmt: skip
    half = 11.0
    optics = model(design(*lights, camera=centred), cap, half=half, step_mm=0.1, refraction=False)
    angles = [math.atan(82 / 120), math.atan(62 / 120)]
    seen = 4 * math.asin(math.sin(angles[0]) * math.sin(angles[1])) * radius**2
    face = optics.rest_face
    corners = face.points_mm[face.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    whole = 0.5 * np.linalg.norm(normals, axis=1).sum()
    figures = measure_photometry(optics)
    assert figures.visible_fraction == pytest.approx(seen / whole, rel=0.01)


def test_dots_count_in_no_figure():
    lights = far_lights((0.0, 120.0, 240.0), 40.0)
    plain = measure_photometry(model(design(*lights), refraction=False))
    dotted = measure_photometry(
        model(design(*lights), refraction=False, markers=MarkerGrid(3, 4, 4.0, 4.0, 1.5))
    )
    assert dotted.uniformity_min_over_mean == pytest.approx(plain.uniformity_min_over_mean)
    # Exposure is that of the picture with its dots.
    assert dotted.levels_per_deg == pytest.approx(plain.levels_per_deg, rel=0.1)


def test_window_smaller_than_the_view_hides_the_rest():
    lights = far_lights((0.0, 120.0, 240.0), 40.0)
    small = replace(PLATE, size_mm=(6.0, 30.0))
    image = model(design(*lights, window=small)).render()
    assert 0.2 < image.mask.mean() < 0.45
    assert (image.rgb[~image.mask] == 0).all()
    assert np.isnan(image.points_mm[~image.mask]).all()


def test_evenness_shadows_and_saturation():
    even = model(design(*far_lights((0.0, 120.0, 240.0), 40.0), camera=camera(falloff=0.0)),
                 refraction=False)  # fmt: skip
    figures = measure_photometry(even)
    assert min(figures.uniformity_min_over_mean) > 0.98
    assert max(figures.uniformity_variation) < 0.02
    assert figures.shadowed_fraction == 0.0
    assert figures.saturated_fraction == 0.0
    near = Light((4.0, 0.0, -3.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    spot = measure_photometry(model(design(near), refraction=False, level=180.0))
    assert spot.uniformity_min_over_mean[0] < 0.1
    assert spot.saturated_fraction > 0.05


@pytest.mark.thorough
def test_shading_gain_is_the_slope_of_the_picture():
    """Grey levels of a gel tilted as a whole against the figure for a small tilt."""
    lights = far_lights((0.0, 120.0, 240.0), 40.0)
    straight = {"refraction": False, "half": 25.0}
    flat = model(design(*lights, camera=camera(falloff=0.0)), **straight)
    gain = measure_photometry(flat)
    tilt = math.radians(0.5)

    def change(azimuth):
        way = np.array([math.cos(azimuth), math.sin(azimuth)])
        tilted = model(
            design(*lights, camera=camera(falloff=0.0)),
            lambda xy: math.tan(tilt) * (xy @ way) - 0.0,
            **straight,
        )
        return (flat.display.levels(tilted.render().linear) - flat.display.levels(
            flat.render().linear
        ))[15, 20] / 0.5  # fmt: skip

    steps = np.stack([change(a) for a in np.linspace(0, 2 * math.pi, 24, endpoint=False)])
    np.testing.assert_allclose(np.abs(steps).max(axis=0), gain.levels_per_deg, rtol=0.03)
    assert np.linalg.norm(steps, axis=1).min() == pytest.approx(
        gain.weakest_levels_per_deg, rel=0.03
    )


def test_a_turbid_gel_shows_no_slopes():
    lights = far_lights((0.0, 120.0, 240.0), 40.0)
    turbid = design(*lights, coating=Coating((0.05, 0.05, 0.05)), gel_scattering_per_mm=0.5)
    figures = measure_photometry(model(turbid, refraction=False))
    assert figures.levels_per_deg == (0.0, 0.0, 0.0)


def test_depth_of_field():
    near, far = sharp_range_mm(800.0, 0.5, 20.0)
    for limit in (near, far):
        assert blur_px(np.array(limit), 800.0, 0.5, 20.0) == pytest.approx(1.0)
    assert near < 20 < far
    assert sharp_range_mm(800.0, 0.01, 20.0)[1] == math.inf
    lights = far_lights((0.0, 120.0, 240.0), 40.0)
    assert measure_photometry(model(design(*lights))).depth_of_field is None
    apparent = (-CAMERA_Z - 3.0 - GEL_MM) + 3.0 / 1.49 + GEL_MM / 1.41
    sharp = design(*lights, window=PLATE, camera=camera(focus_mm=apparent, aperture_mm=2.0))
    figures = measure_photometry(model(sharp)).depth_of_field
    assert figures is not None
    assert figures.sharp_fraction == 1.0
    assert figures.worst_blur_px < 1e-3
    assert figures.depth_in_gel_mm == pytest.approx(1.41 * (figures.far_mm - figures.near_mm))
    off = replace(sharp, camera=camera(focus_mm=10.0, aperture_mm=2.0))
    blurred = measure_photometry(model(off)).depth_of_field
    assert blurred is not None
    assert blurred.sharp_fraction == 0.0
    assert blurred.worst_blur_px == pytest.approx(60 * 2 * (1 / 10 - 1 / apparent), rel=1e-4)
