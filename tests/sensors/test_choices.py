# SPDX-License-Identifier: Apache-2.0
"""What an engineer chooses: hardness of the gel, lens and image sensor by data sheet, rings of
LEDs; what follows in CAD: assemblies whose parts do not interpenetrate, moulds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from build123d import Plane
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.cad.assembly import require_no_overlap
from taccel_lab.cad.moulds import casting_moulds
from taccel_lab.cad.parameters import parse_overrides
from taccel_lab.cad.parts.pad_solid import gel_layers, labelled_solid
from taccel_lab.cad.parts.placeholders import camera_location, led_location, led_names, led_part
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import DesignedCamera, Light
from taccel_lab.sensors import FamilyParameters
from taccel_lab.sensors.camera_sensor import CameraSensorParameters
from taccel_lab.sensors.design import stiffness_words
from taccel_lab.sensors.parameter_groups.material import FACTOR, READINGS, Scale, modulus_of_shore
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.sensors.workshop import sensor_parts
from tests.support.sensor_refusals import refuses
from tests.support.variants import variants

FAMILIES = sorted(sensor_families())
LENS = {"scale_from": "lens_focal_mm", "lens_focal_mm": 2.1, "pixel_pitch_um": 1.4}
STRETCHED_TO_TWICE: dict[tuple[Scale, float], float] = {
    ("00", 30): 0.069, ("00", 50): 0.083, ("A", 10): 0.151, ("A", 20): 0.338, ("A", 30): 0.593,
}  # fmt: skip
"""Stress [MPa] of casting silicones (Ecoflex 00-30, 00-50; Dragon Skin 10, 20, 30) at 100 % strain,
by their maker's data sheets; neo-Hookean, E is 12/7 of it."""


def made(name: str, **values: Any) -> FamilyParameters:
    return sensor_family(name).parameters(values)


def test_moduli_of_a_hardness_are_those_of_gent_of_both_scales_and_of_silicones() -> None:
    assert modulus_of_shore("A", 10).pa == pytest.approx(0.413e6, rel=2e-3)
    # Readings of one rubber on both scales, from suppliers' tables.
    for a, double_o in ((20, 70), (25, 76), (30, 80), (35, 83)):
        ratio = modulus_of_shore("00", double_o).pa / modulus_of_shore("A", a).pa
        assert 1 / 1.4 < ratio < 1.4
    for (scale, reading), stress in STRETCHED_TO_TWICE.items():
        found = modulus_of_shore(scale, reading)
        assert found.low_pa <= 12 / 7 * stress * 1e6 <= found.high_pa


@given(scale=st.sampled_from(["00", "A"]), data=st.data())
def test_harder_is_stiffer(scale: Scale, data: st.DataObject) -> None:
    readings = sorted(data.draw(st.tuples(*2 * [st.floats(*READINGS[scale])])))
    soft, hard = (modulus_of_shore(scale, reading) for reading in readings)
    assert 1e4 < soft.pa <= hard.pa < 5e7
    assert soft.low_pa * FACTOR < soft.pa < soft.high_pa / FACTOR


def test_a_gel_of_a_hardness_is_incompressible_unless_something_else_is_given() -> None:
    gel = made("digit", shore_00=40)
    assert gel.material().young_modulus_pa == modulus_of_shore("00", 40).pa
    assert gel.material().young_interval_pa is not None
    assert made("digit").material().young_interval_pa is None
    assert gel.material().poisson_ratio == 0.499 and "skin_poisson_ratio" not in gel.values()
    found = made("9dtact", shore_00=40)
    assert [m.poisson_ratio for m in found.layer_materials()] == [0.499, 0.499]
    assert "hardness" in found.describe()["poisson_ratio"]["source"]
    given = made("9dtact", shore_a=15, poisson_ratio=0.46)
    core, skin = given.layer_materials()
    assert skin.young_modulus_pa == core.young_modulus_pa
    assert (core.poisson_ratio, skin.poisson_ratio) == (0.46, 0.499)
    assert given.describe()["poisson_ratio"]["value"] == 0.46
    for values in ({}, {"shore_00": 0.0}, {"young_modulus_mpa": 0.2}):
        assert made("9dtact", **values).material().poisson_ratio == 0.46
    # Drawings say how hard the gel is.
    assert stiffness_words(made("9dtact")) == "E 0.2 and 0.2 MPa"
    assert stiffness_words(made("digit", shore_00=30)) == "Shore 00 30, E 0.106 MPa"


def test_a_lens_and_an_image_sensor_give_the_scale() -> None:
    """f / pitch pixels of the picture; the tactile image is its middle half, 320 px wide."""
    picture = {"raw_width_px": 3280, "raw_height_px": 2464, "crop_x": 0.5}
    near = made("flat_pad", **LENS, **picture)
    far = made("flat_pad", **LENS, **picture, camera_distance_mm=45.0)
    assert isinstance(near, CameraSensorParameters) and isinstance(far, CameraSensorParameters)
    assert near.camera().fx_px == pytest.approx(2.1e3 / 1.4 * 320 / (3280 * 0.5))
    # Twice as far away, half as large: through window and gel as seen from the lens.
    ratio = far.apparent_distance_mm() / near.apparent_distance_mm()
    assert far.grid().mm_per_px_x / near.grid().mm_per_px_x == pytest.approx(ratio)
    # A fisheye has no distortion of another lens.
    usual, fisheye = made("digit").optics(), made("digit", lens_model="fisheye").optics()
    assert usual is not None and len(usual.camera.distortion) == 5
    assert fisheye is not None and fisheye.camera.model == "fisheye"
    assert fisheye.camera.distortion == ()


def lights(name: str = "flat_pad", **values: Any) -> tuple[Light, ...]:
    """Those of a flat pad stand at -90, 30 and 150 deg."""
    design = made(name, **values).optics()
    assert design is not None
    return design.lights


def test_a_ring_of_leds_takes_the_place_of_the_familys() -> None:
    ring = {"led_count": 4, "led_angle_deg": 45, "led_colors": "rgb", "led_tilt_deg": 90}
    found = lights("gelsight_mini", **ring)
    assert [light.name for light in found] == ["red 0", "green 1", "blue 2", "red 3"]
    places = np.array([light.position_mm for light in found])
    inward = np.array([light.direction for light in found])
    assert places[1, 0] == pytest.approx(-places[0, 0]) and places[0, :2].min() > 0
    assert inward[:, 2] == pytest.approx(0, abs=1e-12)
    assert (inward[:, :2] * places[:, :2]).sum(axis=1).max() < 0
    assert {light.rgb for light in lights("rtac")} == {(1.0, 1.0, 1.0)}
    # Rings and triples are short forms of lists.
    angles, colors = [15.0 + 60.0 * k for k in range(6)], ["red", "green", "blue"]
    ring_of_6 = lights(led_count=6, led_angle_deg=15)
    assert ring_of_6 == lights(led_angle_deg=angles, led_colors=colors * 2)
    assert lights() == lights(led_angle_deg=[-90, 30, 150], led_colors=colors)
    assert lights(led_count=3) == lights()


def test_each_led_has_its_own_place_colour_direction_and_beam() -> None:
    words = (
        "led_angle_deg=0,90,200 led_colors=red,#ff8000,white led_x_mm=10,12,14 led_depth_mm=3,6,9 "
        "led_tilt_deg=0,90,90 led_turn_deg=0,0,30 led_half_angle_deg=60,30,0 led_lobe=2.5 "
        "led_power=1,0.5,2"
    )
    red, amber, white = lights(**parse_overrides(words.split()))
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


test_what_cannot_be_chosen_is_refused = refuses(
    lambda values: made("flat_pad", **values),
    ({"led_count": 4}, "led_count = 4, but led_angle_deg has 3 values"),
    ({"led_tilt_deg": [60, 90]}, "led_tilt_deg has 2 values for 3 LEDs; give one, or one"),
    ({"led_x_mm": [12, 0, 12]}, "led_x_mm = 0 is below its bound"),
    ({"led_x_mm": [12, "a", 12]}, "led_x_mm = 'a' is not a number; allowed: 1 to 100 mm"),
    ({"led_colors": ["red", "pink", "#00ff"]}, "led_colors = 'pink' is not allowed; use one"),
    ({"led_colors": "#000000"}, "led_colors = #000000 is no light"),
    ({"led_x_mm": []}, "led_x_mm has 0 values"),
    ({"ambient": [1, 2]}, r"ambient = \[1, 2\] is not a number"),
    ({"shore_00": 30, "shore_a": 10}, "shore_00 and shore_a are given"),
    ({"shore_00": 30, "young_modulus_mpa": 0.3}, "young_modulus_mpa and shore_00 are given"),
    ({"shore_00": 120}, "above its bound; allowed: 0 .not given. or 5 to 90"),
    ({"shore_a": math.nan}, "is not a number"),
    ({"shore_00": "55 OO"}, "is not a number"),
    ({"lens_model": "telecentric"}, "lens_model = .* use one of pinhole, fisheye"),
    ({**LENS, "pixel_pitch_um": 0}, "needs lens_focal_mm and pixel_pitch_um"),
)


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
    parameters = made(
        "flat_pad", led_count=1, led_angle_deg=0, led_arc_deg=180, led_size_mm=1.5, led_tilt_deg=90,
        led_depth_mm=14,
    )  # fmt: skip
    assembly = sensor_parts("flat_pad", parameters)
    guide = assembly.part("led_red").solid
    assert guide.volume == pytest.approx(np.pi * (14.0 + 0.3) * 0.6 * 1.5, rel=1e-6)
    box = guide.bounding_box()
    assert (box.max.X, box.min.Y, box.max.Y) == pytest.approx((14.6, -14.6, 14.6), abs=1e-3)
    assert (box.min.Z, box.max.Z) == pytest.approx((-14.75, -13.25), abs=1e-6)
    require_no_overlap(assembly.clearances())


@pytest.mark.thorough
def test_a_housing_follows_what_it_holds_unless_it_is_stated() -> None:
    housing = made("digit_360", dome_radius_mm=11).housing()
    assert housing is not None and housing.front_z_mm == pytest.approx(-24.5)
    wide = made("flat_pad", length_x_mm=40)
    housing = wide.housing()
    assert housing is not None and housing.size_mm[:2] == pytest.approx((41, 34))
    require_no_overlap(sensor_parts("flat_pad", wide).clearances())
    with pytest.raises(InputError, match=r"housing_x_mm = 36 is too small .* at least 41\.00 mm"):
        sensor_parts("flat_pad", made("flat_pad", length_x_mm=40, housing_x_mm=36))


@pytest.mark.thorough
@pytest.mark.parametrize("name", variants(["digit", "digit_360", "rtac"], FAMILIES))
def test_parts_fit(name: str) -> None:
    parameters = made(name)
    pad, optics, housing = parameters.pad(), parameters.optics(), parameters.housing()
    gel = labelled_solid(pad)
    assembly = sensor_parts(name, parameters, gel)
    clearances = assembly.clearances()
    require_no_overlap(clearances)
    touching = {(c.first, c.second) for c in clearances if c.gap_mm == 0}
    layers = [part for part in assembly.parts if part.gel]
    assert sum(part.solid.volume for part in layers) == pytest.approx(gel.volume_mm3, rel=2e-3)
    if optics is not None and optics.window is not None:
        assert touching >= {(layers[0].name, "window"), ("window", "housing")}
        window = assembly.part("window").solid
        assert window.location.position.Z == pytest.approx(-pad.thickness_mm)
    else:
        assert (layers[0].name, "housing") in touching
    if optics is not None:
        camera = assembly.part("camera").solid.location.position
        assert tuple(camera) == pytest.approx(optics.camera.position_mm, abs=1e-9)
        assert sum(part.name.startswith("led_") for part in assembly.parts) == len(optics.lights)
    assert housing is not None
    box, cover = (assembly.part(part).solid.bounding_box() for part in ("housing", "cover"))
    size = (box.size.X, box.size.Y, box.max.Z - cover.min.Z)
    assert size == pytest.approx(housing.size_mm, abs=1e-6)
    assert all(part.solid.is_valid for part in assembly.parts)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_gels_can_be_cast(name: str) -> None:
    pad = made(name).pad()
    gel = labelled_solid(pad)
    layers = gel_layers(pad, gel)
    found = casting_moulds(gel, layers)
    assert len(found) == len(layers)
    for mould, report in found:
        assert mould.cavity.solid.is_valid and mould.lid.solid.is_valid
        assert report.undercut_mm2 < 0.05 and report.overlap_mm3 < 1e-3


@pytest.mark.thorough
def test_two_layers_are_two_parts_that_fill_the_gel() -> None:
    parameters = made("9dtact")
    pad = parameters.pad()
    gel = labelled_solid(pad)
    layers = gel_layers(pad, gel)
    assert list(layers) == list(pad.layer_names) == ["gel", "skin"]
    volumes = [layer.volume_mm3 for layer in layers.values()]
    assert sum(volumes) == pytest.approx(gel.volume_mm3, rel=1e-6)
    names = {part.name: set(part.face_names) for part in sensor_parts("s", parameters).parts[:2]}
    assert names == {"gel": {"bond", "window", "side"}, "skin": {"bond", "contact", "side"}}


def test_poses_turn_as_the_optics_do() -> None:
    half = np.sqrt(0.5)
    camera = DesignedCamera(
        640, 480, 500.0, 500.0, 319.5, 239.5, (1.0, 2.0, -30.0), rotation=(half, 0.0, 0.0, half)
    )
    plane, turn = Plane(camera_location(camera)), camera.gel_from_camera()
    assert tuple(plane.z_dir) == pytest.approx(tuple(turn[:, 2]))
    assert tuple(plane.x_dir) == pytest.approx(tuple(turn[:, 0]))
    assert tuple(plane.origin) == pytest.approx(camera.position_mm)
    up = Light((0.0, 0.0, -5.0), (0.0, 0.0, 1.0), (1.0, 0.5, 0.0), name="a")
    side = Light((5.0, 0.0, -5.0), (-1.0, 0.0, 0.0), (0.0, 0.2, 0.0), (3.0, 1.0), name="a")
    assert led_names((up, side)) == ["led_a", "led_a_1"]
    for light, size, color in ((up, (0.5, 0.5), (1.0, 0.5, 0.0)), (side, (3.0, 1.0), (0, 1.0, 0))):
        part = led_part(light)
        box = part.solid.bounding_box().size
        assert (box.X, box.Y) == pytest.approx(size)
        assert part.color == color
    # The width lies in the xy plane.
    assert Plane(led_location(side)).x_dir.Z == pytest.approx(0)
