# SPDX-License-Identifier: Apache-2.0
"""What an engineer chooses: lens and image sensor by data sheet, rings of LEDs, what follows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from taccel_lab.cad.assembly import require_no_overlap
from taccel_lab.cad.parameters import parse_overrides
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import Light
from taccel_lab.sensors.camera_sensor import CameraSensorParameters
from taccel_lab.sensors.design import stiffness_words
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.sensors.workshop import sensor_parts

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
    ring = {"led_count": 4, "led_angle_deg": 45, "led_colors": "rgb", "led_tilt_deg": 90}
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


def lights(**values: Any) -> tuple[Light, ...]:
    """Of a flat pad, whose three LEDs stand at -90, 30 and 150 deg."""
    design = sensor_family("flat_pad").parameters(values).optics()
    assert design is not None
    return design.lights


def test_each_led_has_its_own_place_colour_direction_and_beam() -> None:
    red, amber, white = lights(
        **parse_overrides([
            "led_angle_deg=0,90,200", "led_colors=red,#ff8000,white", "led_x_mm=10,12,14",
            "led_depth_mm=3,6,9", "led_tilt_deg=0,90,90", "led_turn_deg=0,0,30",
            "led_half_angle_deg=60,30,0", "led_lobe=2.5", "led_power=1,0.5,2",
        ])
    )  # fmt: skip
    assert red.position_mm == pytest.approx((10, 0, -3))
    assert red.direction == pytest.approx((0, 0, 1))
    assert amber.position_mm == pytest.approx((0, 14, -6))
    assert amber.direction == pytest.approx((0, -1, 0))
    assert amber.rgb == pytest.approx((0.5, 0.5 * 128 / 255, 0))
    turned = np.radians(200 + 30)
    assert white.direction == pytest.approx((-np.cos(turned), -np.sin(turned), 0))
    assert white.rgb == (2.0, 2.0, 2.0)
    # Half the intensity at the half angle: a Lambertian emitter has 60 deg.
    assert red.lobe == pytest.approx(1.0)
    assert np.cos(np.radians(30)) ** amber.lobe == pytest.approx(0.5)
    assert white.lobe == 2.5
    assert [light.name for light in (red, amber, white)] == ["red", "#ff8000", "white"]


def test_rings_and_triples_are_short_forms_of_lists() -> None:
    angles = [15.0 + 60.0 * k for k in range(6)]
    colors = ["red", "green", "blue"] * 2
    ring = lights(led_count=6, led_angle_deg=15)
    assert ring == lights(led_angle_deg=angles, led_colors=colors)
    assert lights() == lights(led_angle_deg=[-90, 30, 150], led_colors=["red", "green", "blue"])
    assert lights(led_count=3) == lights()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"led_count": 4}, "led_count = 4, but led_angle_deg has 3 values"),
        ({"led_tilt_deg": [60, 90]}, "led_tilt_deg has 2 values for 3 LEDs; give one, or one"),
        ({"led_x_mm": [12, 0, 12]}, "led_x_mm = 0 is below its bound"),
        ({"led_x_mm": [12, "a", 12]}, "led_x_mm = 'a' is not a number; allowed: 1 to 100 mm"),
        ({"led_colors": ["red", "pink", "#00ff"]}, "led_colors = 'pink' is not allowed; use one"),
        ({"led_colors": "#000000"}, "led_colors = #000000 is no light"),
        ({"led_x_mm": []}, "led_x_mm has 0 values"),
        ({"ambient": [1, 2]}, "ambient = [1, 2] is not a number"),
    ],
)
def test_values_that_are_not_one_for_each_led_are_refused(
    values: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError) as error:
        lights(**values)
    assert words in str(error.value)


def test_a_guide_is_an_led_with_a_length_or_an_arc() -> None:
    strip, arc, ring = lights(
        led_length_mm=[20, 5, 0], led_arc_deg=[0, 90, 360], led_size_mm=1.5, led_tilt_deg=90
    )
    assert (strip.size_mm, strip.arc_deg) == ((20.0, 1.5), 0.0)
    assert (arc.size_mm, arc.arc_deg) == ((0.0, 1.5), 90.0)
    assert strip.straight_pieces() == (strip,)
    pieces = ring.straight_pieces()
    assert len(pieces) == 8
    assert np.sum([piece.rgb for piece in pieces], axis=0) == pytest.approx(ring.rgb)
    assert np.mean([piece.position_mm for piece in pieces], axis=0)[:2] == pytest.approx([0, 0])
    for piece in pieces:
        assert np.hypot(*piece.position_mm[:2]) == pytest.approx(14)
        assert np.dot(piece.position_mm[:2], piece.direction[:2]) == pytest.approx(-14)


@pytest.mark.thorough
def test_cad_makes_room_for_a_bent_guide() -> None:
    """The exit's section turned about the axis: its volume is that of Pappus."""
    parameters = sensor_family("flat_pad").parameters({
        "led_count": 1, "led_angle_deg": 0, "led_arc_deg": 180, "led_size_mm": 1.5,
        "led_tilt_deg": 90, "led_depth_mm": 14,
    })  # fmt: skip
    assembly = sensor_parts("flat_pad", parameters)
    guide = assembly.part("led_red").solid
    middle = 14.0 + 0.3
    assert guide.volume == pytest.approx(np.pi * middle * 0.6 * 1.5, rel=1e-6)
    box = guide.bounding_box()
    assert (box.max.X, box.min.Y, box.max.Y) == pytest.approx((14.6, -14.6, 14.6), abs=1e-3)
    assert (box.min.Z, box.max.Z) == pytest.approx((-14.75, -13.25), abs=1e-6)
    require_no_overlap(assembly.clearances())


@pytest.mark.thorough
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
