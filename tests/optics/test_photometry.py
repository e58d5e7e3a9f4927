# SPDX-License-Identifier: Apache-2.0
"""Photometric figures of designs whose figures are known."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

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
from tests.optics.flat_gel import CAMERA_Z, GEL_MM, PLATE, camera, design, flat_top, model, towards

FAR = 4000.0
APPARENT = (-CAMERA_Z - 3.0 - GEL_MM) + 3.0 / 1.49 + GEL_MM / 1.41
"""Distance [mm] that counts at the axis, through window and gel."""


def far_lights(elevation: float = 40.0, azimuths: tuple[float, ...] = (0, 120, 240)) -> list[Light]:
    """Lights so far away that each shines from one direction, one channel each."""
    return [
        Light(*towards(azimuth, elevation, FAR), tuple(np.eye(3)[k].tolist()))
        for k, azimuth in enumerate(azimuths)
    ]


def measured(*lights: Light, top: Any = flat_top, half: float = 15.0, **changes: Any) -> Any:
    """Figures of a design in air; ``changes``: of it, or options of its model."""
    names = ("camera", "coating", "gel_scattering_per_mm", "window")
    of_design = {name: changes.pop(name) for name in names if name in changes}
    options = {"refraction": False, **changes}
    return measure_photometry(model(design(*lights, **of_design), top, half, **options))


@pytest.mark.parametrize("elevation", [25.0, 35.2644, 60.0])
def test_three_lights_at_120_degrees(elevation):
    """Unit rows at elevation e have the singular values cos(e) sqrt(3/2), twice, and sin(e)
    sqrt(3)."""
    figures, e = measured(*far_lights(elevation)), math.radians(elevation)
    sides = (math.cos(e) * math.sqrt(1.5), math.sin(e) * math.sqrt(3))
    found = figures.condition_number
    assert figures.light_rank == 3
    assert found.median == pytest.approx(max(sides) / min(sides), rel=2e-3)
    assert found.maximum == pytest.approx(found.minimum, rel=0.03)


@given(matrix=st.lists(st.floats(-1, 1), min_size=9, max_size=9), gain=st.floats(0.1, 10))
def test_condition_number_is_that_of_the_unit_rows(matrix, gain):
    rows = np.array(matrix).reshape(3, 3)
    lengths = np.linalg.norm(rows, axis=1)
    if lengths.min() < 1e-3 or np.linalg.svd(rows / lengths[:, None])[1][2] < 0.05:
        return
    # The strength of a channel's light changes nothing.
    scaled = rows * np.array([[gain], [1.0], [1 / gain]])
    rank, condition = channel_independence(np.stack([scaled, scaled]))
    assert rank == 3
    assert condition.median == pytest.approx(np.linalg.cond(rows / lengths[:, None]), rel=1e-6)


def test_sensors_without_three_directions_say_so():
    grey = measured(Light(*towards(0, 40, FAR), (1.0, 1.0, 1.0)))
    two = measured(*far_lights(40.0, (0.0, 120.0)))
    assert (grey.light_rank, two.light_rank) == (1, 2)
    assert grey.condition_number is two.condition_number is None
    # A channel that no light feeds is dark, not an error.
    assert math.isnan(two.uniformity_variation[2])
    assert two.to_json()["uniformity_variation"][2] is None
    assert json.loads(json.dumps(two.to_json()))["light_rank"] == 2


def test_scale_of_a_pinhole_over_a_flat_gel():
    oblong = camera(fy_px=75.0)
    straight = measured(*far_lights(), camera=oblong)
    for spread, focal in ((straight.mm_per_px_x, 60.0), (straight.mm_per_px_y, 75.0)):
        assert spread.minimum == pytest.approx(-CAMERA_Z / focal, rel=1e-4)
        assert spread.maximum == pytest.approx(-CAMERA_Z / focal, rel=1e-4)
    assert straight.anisotropy.median == pytest.approx(75 / 60, rel=1e-3)
    # Window and gel shorten the distance that counts at the axis, and bend more off it.
    bent = measured(*far_lights(), camera=oblong, window=PLATE, refraction=True).mm_per_px_x
    assert bent.maximum == pytest.approx(APPARENT / 60.0, rel=1e-3)
    assert bent.minimum < 0.999 * APPARENT / 60.0


def test_footprint_of_a_sheared_image():
    v, u = np.mgrid[:5, :6].astype(float)
    points = np.stack([0.2 * u + 0.1 * v, 0.3 * v, 0 * u], axis=-1)
    across, down, anisotropy = pixel_footprint(points)
    sides = np.linalg.svd(np.array([[0.2, 0.0], [0.1, 0.3]]), compute_uv=False)
    wanted = (0.2, math.hypot(0.1, 0.3), sides[0] / sides[1])
    assert [np.nanmax(each) for each in (across, down, anisotropy)] == pytest.approx(wanted)
    assert np.isnan(across[:, 0]).all()


@pytest.mark.parametrize("half", [30.0, 6.0])
def test_visible_fraction(half):
    expected = min(1.0, 41 * 0.5 * 31 * 0.5 / (2 * half) ** 2)
    found = measured(*far_lights(), half=half, size_px=(164, 124)).visible_fraction
    assert found == pytest.approx(expected, rel=0.02)


def test_visible_part_of_a_dome():
    """A pinhole in the centre of a sphere sees R^2 times its rectangle's solid angle."""
    radius = 12.0

    def cap(xy):
        return np.sqrt(np.maximum(radius**2 - np.sum(xy**2, axis=-1), 0.04)) - radius

    centred = camera(
        width_px=164, height_px=124, fx_px=120.0, fy_px=120.0, cx_px=81.5, cy_px=61.5,
        position_mm=(0.0, 0.0, -radius),
    )  # fmt: skip
    seen_by = design(*far_lights(60.0), camera=centred)
    optics = model(seen_by, cap, half=11.0, step_mm=0.1, refraction=False)
    x, y = math.atan(82 / 120), math.atan(62 / 120)
    seen = 4 * math.asin(math.sin(x) * math.sin(y)) * radius**2
    corners = optics.rest_face.points_mm[optics.rest_face.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    whole = 0.5 * np.linalg.norm(normals, axis=1).sum()
    assert measure_photometry(optics).visible_fraction == pytest.approx(seen / whole, rel=0.01)


def test_dots_count_in_no_figure():
    plain, dotted = (
        measured(*far_lights(), markers=dots) for dots in (None, MarkerGrid(3, 4, 4.0, 4.0, 1.5))
    )
    assert dotted.uniformity_min_over_mean == pytest.approx(plain.uniformity_min_over_mean)
    # Exposure is that of the picture with its dots.
    assert dotted.levels_per_deg == pytest.approx(plain.levels_per_deg, rel=0.1)


def test_window_smaller_than_the_view_hides_the_rest():
    small = replace(PLATE, size_mm=(6.0, 30.0))
    image = model(design(*far_lights(), window=small)).render()
    assert 0.2 < image.mask.mean() < 0.45
    assert (image.rgb[~image.mask] == 0).all()
    assert np.isnan(image.points_mm[~image.mask]).all()


def test_evenness_shadows_and_saturation():
    figures = measured(*far_lights(), camera=camera(falloff=0.0))
    assert min(figures.uniformity_min_over_mean) > 0.98
    assert max(figures.uniformity_variation) < 0.02
    assert figures.shadowed_fraction == figures.saturated_fraction == 0.0
    spot = measured(Light((4.0, 0.0, -3.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0)), level=180.0)
    assert spot.uniformity_min_over_mean[0] < 0.1
    assert spot.saturated_fraction > 0.05


@pytest.mark.thorough
def test_shading_gain_is_the_slope_of_the_picture():
    """Grey levels of a gel tilted as a whole against the figure for a small tilt."""
    optics, straight = design(*far_lights(), camera=camera(falloff=0.0)), {"refraction": False}
    flat = model(optics, half=25.0, **straight)
    gain, before = measure_photometry(flat), flat.display.levels(flat.render().linear)
    steps = []
    for azimuth in np.linspace(0, 2 * math.pi, 24, endpoint=False):
        way = math.tan(math.radians(0.5)) * np.array([math.cos(azimuth), math.sin(azimuth)])
        tilted = model(optics, lambda xy, way=way: xy @ way, half=25.0, **straight).render().linear
        steps.append((flat.display.levels(tilted) - before)[15, 20] / 0.5)
    np.testing.assert_allclose(np.abs(steps).max(axis=0), gain.levels_per_deg, rtol=0.03)
    weakest = np.linalg.norm(steps, axis=1).min()
    assert weakest == pytest.approx(gain.weakest_levels_per_deg, rel=0.03)


def test_a_turbid_gel_shows_no_slopes():
    turbid = {"coating": Coating((0.05, 0.05, 0.05)), "gel_scattering_per_mm": 0.5}
    assert measured(*far_lights(), **turbid).levels_per_deg == (0.0, 0.0, 0.0)


def test_depth_of_field():
    near, far = sharp_range_mm(800.0, 0.5, 20.0)
    for limit in (near, far):
        assert blur_px(np.array(limit), 800.0, 0.5, 20.0) == pytest.approx(1.0)
    assert near < 20 < far
    assert sharp_range_mm(800.0, 0.01, 20.0)[1] == math.inf
    assert measured(*far_lights()).depth_of_field is None
    sharp, blurred = (
        measured(
            *far_lights(), window=PLATE, camera=camera(focus_mm=focus, aperture_mm=2.0),
            refraction=True,
        ).depth_of_field
        for focus in (APPARENT, 10.0)
    )  # fmt: skip
    assert sharp.sharp_fraction == 1.0 and sharp.worst_blur_px < 1e-3
    assert sharp.depth_in_gel_mm == pytest.approx(1.41 * (sharp.far_mm - sharp.near_mm))
    assert blurred.sharp_fraction == 0.0
    assert blurred.worst_blur_px == pytest.approx(60 * 2 * (1 / 10 - 1 / APPARENT), rel=1e-4)
