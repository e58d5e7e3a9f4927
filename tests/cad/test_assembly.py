# SPDX-License-Identifier: Apache-2.0
"""Parts sit where their joints say, touch where they should and do not interpenetrate."""

from __future__ import annotations

import math

import pytest
from build123d import Compound, Pos

from taccel_lab.cad.assembly import Assembly, require_no_overlap
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.cad.parts.part import gel_part
from taccel_lab.cad.parts.placeholders import led_names
from taccel_lab.cad.parts.solids import common_volume_mm3
from taccel_lab.cad.parts.window import window_part
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import Light, Window
from tests.cad.small_sensor import CAMERA, LEDS, PAD, VIEW_MM, WINDOW, housing, small_sensor


def dome(thickness_mm: float, base_mm: float, radius_mm: float) -> Window:
    return Window(thickness_mm, (base_mm, base_mm), shape="dome", outer_radius_mm=radius_mm)


@pytest.fixture(scope="module")
def sensor() -> Assembly:
    return small_sensor()


@pytest.mark.thorough
def test_joints_put_every_part_in_its_place(sensor: Assembly) -> None:
    names = [part.name for part in sensor.parts]
    assert names == ["gel_pad", "window", "housing", "cover", "camera", *led_names(LEDS)]
    window, camera = sensor.part("window").solid, sensor.part("camera").solid
    assert tuple(window.location.position) == pytest.approx((0, 0, -5))
    assert tuple(camera.location.position) == pytest.approx(CAMERA.position_mm)
    assert sensor.part("gel_pad").solid.bounding_box().max.Z == pytest.approx(0, abs=1e-6)
    assert sensor.part("housing").solid.bounding_box().max.Z == pytest.approx(-3.5)
    assert sensor.part("cover").solid.bounding_box().min.Z == pytest.approx(-33.5)
    red = sensor.part("led_red")
    (emitting,) = red.faces("emitting")
    assert tuple(emitting.center()) == pytest.approx((12.5, 0, -12))
    assert tuple(emitting.normal_at()) == pytest.approx((-1, 0, 0))
    assert set(sensor.part("housing").solid.joints) >= {"seat", "camera", "cover", "led_red"}
    assert set(window.joints) == {"bond", "seat"}


@pytest.mark.thorough
def test_parts_touch_or_keep_clear_and_none_interpenetrates(sensor: Assembly) -> None:
    clearances = sensor.clearances()
    assert require_no_overlap(clearances) == []
    gaps = {(c.first, c.second): c.gap_mm for c in clearances}
    assert gaps["gel_pad", "window"] == gaps["window", "housing"] == 0
    assert gaps["housing", "cover"] == 0
    assert gaps["gel_pad", "housing"] == pytest.approx(0.1, abs=1e-6)
    for part in sensor.parts:
        assert part.solid.is_valid, part.name


def test_the_seat_carries_the_window_and_leaves_the_view_open(sensor: Assembly) -> None:
    (seat,) = sensor.part("housing").faces("seat")
    assert seat.center().Z == pytest.approx(-8)
    # The ledge is 1 mm wide and starts 0.1 mm outside the window.
    box = seat.bounding_box()
    assert (box.size.X, box.size.Y) == pytest.approx((24.2, 20.2))
    inner = seat.inner_wires()[0].bounding_box()
    assert (inner.size.X, inner.size.Y) == pytest.approx((22, 18))


@pytest.mark.thorough
def test_a_planted_overlap_is_refused_and_named(sensor: Assembly) -> None:
    gel = gel_part(labelled_solid(PAD))
    sunk = gel_part(labelled_solid(PAD), "sunk")
    sunk.solid.location = Pos(0, 0, -1)
    pair = Assembly("pair", (gel, sunk))
    shared = common_volume_mm3(gel.solid, sunk.solid)
    assert shared == pytest.approx(labelled_solid(PAD).volume_mm3 - _slab_mm3(), rel=1e-3)
    with pytest.raises(InputError, match=r"gel_pad and sunk by"):
        require_no_overlap(pair.clearances())


def _slab_mm3() -> float:
    """A sheet of 1 mm over the outline: what two pads 1 mm apart do not share."""
    return 24 * 20 - (4 - math.pi) * 2**2


@pytest.mark.thorough
def test_an_led_inside_the_window_is_a_warning() -> None:
    inside = Light((5.0, 0.0, -7.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0), (1.0, 1.0), name="inside")
    sensor = small_sensor(leds=(inside,))
    (words,) = require_no_overlap(sensor.clearances())
    assert words.startswith("window and led_inside interpenetrate by 0.6 mm^3")


def test_compound_is_labelled_and_coloured(sensor: Assembly) -> None:
    whole = sensor.compound()
    assert isinstance(whole, Compound) and whole.label == "small"
    assert [child.label for child in whole.children] == [part.name for part in sensor.parts]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"housing": housing(size_mm=(24.5, 26.0, 30.0))}, r"housing_x_mm = 24.5 .* at least 25"),
        ({"housing": housing(size_mm=(30.0, 26.0, 5.0))}, r"housing_z_mm = 5 .* at least"),
        ({"housing": housing(front_z_mm=-9.0)}, r"housing_front_mm = 9 .* allowed: up to 8 mm"),
        ({"housing": housing(wall_mm=0.1)}, r"housing_wall_mm = 0.1"),
        ({"view_mm": (23.8, 14.0)}, r"ledge of 0.10 mm"),
        ({"window": dome(3.0, 20.0, 8.0)}, r"allowed: up to 16 mm"),
        ({"window": dome(3.0, 8.0, 20.0)}, r"exceed its thickness"),
    ],
)
def test_what_cannot_be_built_names_the_bound(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        small_sensor(**changes)


def test_window_plate_follows_the_gel_or_is_a_rectangle() -> None:
    outline = labelled_solid(PAD).solid.faces().sort_by()[0].outer_wire()
    like_gel = window_part(WINDOW, outline, VIEW_MM)
    assert like_gel.solid.volume == pytest.approx(3 * (24 * 20 - (4 - math.pi) * 2**2), rel=1e-9)
    (front,) = like_gel.faces("optical_front")
    assert front.area == pytest.approx(18 * 14)
    assert sum(face.area for face in like_gel.faces("bond")) == pytest.approx(
        like_gel.solid.volume / 3 - 18 * 14
    )
    plain = window_part(Window(3.0, (24.0, 18.0)), outline)
    assert plain.solid.volume == pytest.approx(3 * (24 * 18 - (4 - math.pi)), rel=1e-9)


def test_window_dome_is_a_shell() -> None:
    shell = window_part(dome(1.5, 27.0, 13.5))
    assert shell.solid.volume == pytest.approx(2 / 3 * math.pi * (13.5**3 - 12.0**3), rel=1e-6)
    assert sorted(shell.face_names) == ["bond", "optical_back", "seat"]
    (bond,) = shell.faces("bond")
    assert bond.area == pytest.approx(2 * math.pi * 13.5**2, rel=1e-6)


@pytest.mark.thorough
def test_bosses_stand_in_the_corners_only_where_there_is_room() -> None:
    assert small_sensor().notes == ()
    tight = small_sensor(housing=housing(size_mm=(25.4, 21.4, 30.0), wall_mm=1.0))
    assert "no room for screw bosses" in tight.notes[0]
    assert require_no_overlap(tight.clearances()) == []
