# SPDX-License-Identifier: Apache-2.0
"""What an engineer chooses: lens and image sensor by data sheet, rings of LEDs, what follows."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.cad.assembly import require_no_overlap
from taccel_lab.errors import InputError
from taccel_lab.sensors.assembly import sensor_parts
from taccel_lab.sensors.camera_sensor import CameraSensorParameters
from taccel_lab.sensors.design import stiffness_words
from taccel_lab.sensors.registry import sensor_family

LENS = {"scale_from": "lens_focal_mm", "lens_focal_mm": 2.1, "pixel_pitch_um": 1.4}


def test_a_lens_and_an_image_sensor_give_the_scale() -> None:
    """f / pitch pixels of the picture; the tactile image is its middle half, 320 px wide."""
    picture = {"raw_width_px": 3280, "raw_height_px": 2464, "crop_x": 0.5}
    found = sensor_family("flat_pad").parameters({**LENS, **picture})
    assert isinstance(found, CameraSensorParameters)
    camera = found.camera()
    assert camera.fx_px == pytest.approx(2.1e3 / 1.4 * 320 / (3280 * 0.5))
    # Twice as far away, half as large: through window and gel as seen from the lens.
    far = sensor_family("flat_pad").parameters({**LENS, **picture, "camera_distance_mm": 45.0})
    assert isinstance(far, CameraSensorParameters)
    ratio = far.apparent_distance_mm() / found.apparent_distance_mm()
    assert far.grid().mm_per_px_x / found.grid().mm_per_px_x == pytest.approx(ratio)
    with pytest.raises(InputError, match=r"needs lens_focal_mm and pixel_pitch_um"):
        sensor_family("flat_pad").parameters({**LENS, "pixel_pitch_um": 0})


def test_a_fisheye_has_no_distortion_of_another_lens() -> None:
    digit = sensor_family("digit")
    assert len(digit.parameters().optics().camera.distortion) == 5  # type: ignore[union-attr]
    fisheye = digit.parameters({"lens_model": "fisheye"}).optics()
    assert fisheye is not None and fisheye.camera.model == "fisheye"
    assert fisheye.camera.distortion == ()
    with pytest.raises(InputError, match=r"lens_model = .* use one of pinhole, fisheye"):
        digit.parameters({"lens_model": "telecentric"})


def test_a_ring_of_leds_takes_the_place_of_the_familys() -> None:
    ring = {"led_count": 4, "led_start_deg": 45, "led_colors": "rgb", "led_tilt_deg": 90}
    design = sensor_family("gelsight_mini").parameters(ring).optics()
    assert design is not None
    assert [light.name for light in design.lights] == ["red 0", "green 1", "blue 2", "red 3"]
    places = np.array([light.position_mm for light in design.lights])
    inward = np.array([light.direction for light in design.lights])
    assert places[1, 0] == pytest.approx(-places[0, 0]) and places[0, :2].min() > 0
    assert inward[:, 2] == pytest.approx(0, abs=1e-12)
    assert (inward[:, :2] * places[:, :2]).sum(axis=1).max() < 0
    white = sensor_family("rtac").parameters().optics()
    assert white is not None and {light.rgb for light in white.lights} == {(1.0, 1.0, 1.0)}


def test_a_housing_follows_what_it_holds_unless_it_is_stated() -> None:
    family = sensor_family("digit_360")
    parameters = family.parameters({"dome_radius_mm": 11})
    housing = parameters.housing()
    assert housing is not None and housing.front_z_mm == pytest.approx(-24.5)
    wide = sensor_family("flat_pad").parameters({"length_x_mm": 40}).housing()
    assert wide is not None and wide.size_mm[:2] == pytest.approx((41, 34))
    stated = sensor_family("flat_pad").parameters({"length_x_mm": 40, "housing_x_mm": 36})
    with pytest.raises(InputError, match=r"housing_x_mm = 36 is too small .* at least 41\.00 mm"):
        sensor_parts("flat_pad", stated)
    require_no_overlap(
        sensor_parts(
            "flat_pad", sensor_family("flat_pad").parameters({"length_x_mm": 40})
        ).clearances()
    )


def test_drawings_say_how_hard_the_gel_is() -> None:
    family = sensor_family("9dtact")
    assert stiffness_words(family.parameters()) == "E 0.2 and 0.2 MPa"
    soft = stiffness_words(sensor_family("digit").parameters({"shore_00": 30}))
    assert soft == "Shore 00 30, E 0.106 MPa"
