# SPDX-License-Identifier: Apache-2.0
"""A small sensor: parts sit where their joints say and do not interpenetrate; its files are read
back by other programs' readers."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import ezdxf
import numpy as np
import pytest
import pyvista as pv
from build123d import Compound, Mesher, Pos, Unit
from ezdxf import bbox

from taccel_lab.cad import export
from taccel_lab.cad.assembly import Assembly, require_no_overlap
from taccel_lab.cad.drawing.assembly_drawing import assembly_drawing
from taccel_lab.cad.drawing.pad_drawing import pad_drawing
from taccel_lab.cad.drawing.sections import circle_through, section
from taccel_lab.cad.drawing.title import Issue
from taccel_lab.cad.gel_import.step_reader import read_step
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.cad.parts.part import LabelledSolid, gel_part
from taccel_lab.cad.parts.placeholders import led_names
from taccel_lab.cad.parts.solids import common_volume_mm3
from taccel_lab.cad.parts.window import window_part
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import Light, Window
from tests.cad.small_sensor import CAMERA, LEDS, PAD, VIEW_MM, WINDOW, housing, small_sensor
from tests.support.sensor_refusals import refuses

OUTLINE_MM2 = 24 * 20 - (4 - math.pi) * 2**2


@pytest.fixture(scope="module")
def sensor() -> Assembly:
    return small_sensor()


@pytest.fixture(scope="module")
def gel() -> LabelledSolid:
    return labelled_solid(PAD)


def dome(thickness_mm: float, base_mm: float, radius_mm: float) -> Window:
    return Window(thickness_mm, (base_mm, base_mm), shape="dome", outer_radius_mm=radius_mm)


@pytest.mark.thorough
def test_joints_put_every_part_in_its_place_where_none_interpenetrates(sensor: Assembly) -> None:
    names = [part.name for part in sensor.parts]
    assert names == ["gel_pad", "window", "housing", "cover", "camera", *led_names(LEDS)]
    solids = {part.name: part.solid for part in sensor.parts}
    assert tuple(solids["window"].location.position) == pytest.approx((0, 0, -5))
    assert tuple(solids["camera"].location.position) == pytest.approx(CAMERA.position_mm)
    assert solids["gel_pad"].bounding_box().max.Z == pytest.approx(0, abs=1e-6)
    assert solids["housing"].bounding_box().max.Z == pytest.approx(-3.5)
    assert solids["cover"].bounding_box().min.Z == pytest.approx(-33.5)
    (emitting,) = sensor.part("led_red").faces("emitting")
    assert tuple(emitting.center()) == pytest.approx((12.5, 0, -12))
    assert tuple(emitting.normal_at()) == pytest.approx((-1, 0, 0))
    assert set(solids["housing"].joints) >= {"seat", "camera", "cover", "led_red"}
    assert set(solids["window"].joints) == {"bond", "seat"}
    clearances = sensor.clearances()
    assert require_no_overlap(clearances) == [] and sensor.notes == ()
    gaps = {(c.first, c.second): c.gap_mm for c in clearances}
    assert gaps["gel_pad", "window"] == gaps["window", "housing"] == gaps["housing", "cover"] == 0
    assert gaps["gel_pad", "housing"] == pytest.approx(0.1, abs=1e-6)
    assert all(solid.is_valid for solid in solids.values())


def test_the_seat_carries_the_window_and_leaves_the_view_open(sensor: Assembly) -> None:
    (seat,) = sensor.part("housing").faces("seat")
    assert seat.center().Z == pytest.approx(-8)
    # The ledge is 1 mm wide and starts 0.1 mm outside the window.
    outer, inner = seat.bounding_box().size, seat.inner_wires()[0].bounding_box().size
    assert (outer.X, outer.Y, inner.X, inner.Y) == pytest.approx((24.2, 20.2, 22, 18))
    whole = sensor.compound()
    assert isinstance(whole, Compound) and whole.label == "small"
    assert [child.label for child in whole.children] == [part.name for part in sensor.parts]


@pytest.mark.thorough
def test_a_planted_overlap_is_refused_and_named(gel: LabelledSolid) -> None:
    above, sunk = gel_part(gel), gel_part(labelled_solid(PAD), "sunk")
    sunk.solid.location = Pos(0, 0, -1)
    # Two pads 1 mm apart do not share a sheet of 1 mm over the outline.
    shared = common_volume_mm3(above.solid, sunk.solid)
    assert shared == pytest.approx(gel.volume_mm3 - OUTLINE_MM2, rel=1e-3)
    with pytest.raises(InputError, match=r"gel_pad and sunk by"):
        require_no_overlap(Assembly("pair", (above, sunk)).clearances())
    # An LED inside the window and bosses without room are warnings.
    inside = Light((5.0, 0.0, -7.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0), (1.0, 1.0), name="inside")
    (words,) = require_no_overlap(small_sensor(leds=(inside,)).clearances())
    assert words.startswith("window and led_inside interpenetrate by 0.6 mm^3")
    tight = small_sensor(housing=housing(size_mm=(25.4, 21.4, 30.0), wall_mm=1.0))
    assert "no room for screw bosses" in tight.notes[0]
    assert require_no_overlap(tight.clearances()) == []


test_what_cannot_be_built_names_the_bound = refuses(
    lambda changes: small_sensor(**changes),
    ({"housing": housing(size_mm=(24.5, 26.0, 30.0))}, r"housing_x_mm = 24.5 .* at least 25"),
    ({"housing": housing(size_mm=(30.0, 26.0, 5.0))}, r"housing_z_mm = 5 .* at least"),
    ({"housing": housing(front_z_mm=-9.0)}, r"housing_front_mm = 9 .* allowed: up to 8 mm"),
    ({"housing": housing(wall_mm=0.1)}, r"housing_wall_mm = 0.1"),
    ({"view_mm": (23.8, 14.0)}, r"ledge of 0.10 mm"),
    ({"window": dome(3.0, 20.0, 8.0)}, r"allowed: up to 16 mm"),
    ({"window": dome(3.0, 8.0, 20.0)}, r"exceed its thickness"),
)


def test_windows_are_plates_like_the_gel_rectangles_or_shells(gel: LabelledSolid) -> None:
    outline = gel.solid.faces().sort_by()[0].outer_wire()
    like_gel = window_part(WINDOW, outline, VIEW_MM)
    assert like_gel.solid.volume == pytest.approx(3 * OUTLINE_MM2, rel=1e-9)
    (front,) = like_gel.faces("optical_front")
    assert front.area == pytest.approx(18 * 14)
    bonded = sum(face.area for face in like_gel.faces("bond"))
    assert bonded == pytest.approx(OUTLINE_MM2 - 18 * 14)
    plain = window_part(Window(3.0, (24.0, 18.0)), outline)
    assert plain.solid.volume == pytest.approx(3 * (24 * 18 - (4 - math.pi)), rel=1e-9)
    shell = window_part(dome(1.5, 27.0, 13.5))
    assert shell.solid.volume == pytest.approx(2 / 3 * math.pi * (13.5**3 - 12.0**3), rel=1e-6)
    assert sorted(shell.face_names) == ["bond", "optical_back", "seat"]
    (bond,) = shell.faces("bond")
    assert bond.area == pytest.approx(2 * math.pi * 13.5**2, rel=1e-6)


@pytest.mark.thorough
def test_step_keeps_names_colours_faces_and_places(sensor: Assembly, tmp_path: Path) -> None:
    path = tmp_path / "assembly.step"
    export.write_assembly_step(sensor.parts, path, name=sensor.name)
    bodies = {body.name: body for body in read_step(path)}
    assert list(bodies) == [part.name for part in sensor.parts]
    for part in sensor.parts:
        body = bodies[part.name]
        assert body.shape.volume == pytest.approx(part.solid.volume, rel=1e-6)
        low, wanted = (tuple(solid.bounding_box().min) for solid in (body.shape, part.solid))
        assert low == pytest.approx(wanted, abs=1e-5)
        assert Counter(body.face_names) == Counter(part.face_names)
        by_name = dict(zip(body.face_names, body.face_colors, strict=True))
        for name in set(part.face_names):
            color = [int(by_name[name][k : k + 2], 16) / 255 for k in (0, 2, 4)]
            assert color == pytest.approx(part.face_color(name), abs=0.005), (part.name, name)
    products = re.findall(r"=PRODUCT\('([^']*)'", path.read_text().replace(" ", ""))
    assert set(products) == {"small", *bodies}
    # Parts alone are written in their own frame.
    window = sensor.part("window")
    export.write_part_step(window, tmp_path / "window.step")
    (body,) = read_step(tmp_path / "window.step")
    assert body.shape.bounding_box().max.Z == pytest.approx(0, abs=1e-6)
    assert Counter(body.face_names) == Counter(window.face_names)
    export.write_part_stl(window, tmp_path / "window.stl")
    surface = pv.read(tmp_path / "window.stl")
    assert isinstance(surface, pv.PolyData)
    assert surface.volume == pytest.approx(window.solid.volume, rel=1e-4)
    assert surface.bounds[5] == pytest.approx(0, abs=1e-6)


@pytest.mark.thorough
def test_3mf_holds_named_bodies_in_millimetres(sensor: Assembly, tmp_path: Path) -> None:
    path = tmp_path / "sensor.3mf"
    export.write_3mf(sensor.parts, path)
    reader = Mesher()
    reader.model.QueryReader("3mf").ReadFromFile(str(path))
    assert reader.model_unit == Unit.MM
    found = reader.model.GetMeshObjects()
    for part in sensor.parts:
        assert found.MoveNext()
        body = found.GetCurrentMeshObject()
        assert body.GetName() == part.name and body.IsManifoldAndOriented()
        points = np.array([list(v.Coordinates) for v in body.GetVertices()])
        corners = points[np.array([list(t.Indices) for t in body.GetTriangleIndices()])]
        # Chords of 0.06 rad under the crown of radius 50 mm cost up to 0.02 mm of height.
        assert np.linalg.det(corners).sum() / 6 == pytest.approx(part.solid.volume, rel=3e-3)
        group, index, _ = body.GetObjectLevelProperty()
        material = reader.model.GetBaseMaterialGroupByID(group)
        color = reader.wrapper.ColorToFloatRGBA(material.GetDisplayColor(index))
        assert color[:3] == pytest.approx(part.color, abs=0.01)
    assert not found.MoveNext()


def test_dxf_has_outlines_to_scale(gel: LabelledSolid, sensor: Assembly, tmp_path: Path) -> None:
    path = tmp_path / "pad.dxf"
    export.write_dxf(gel, path, others=[part for part in sensor.parts if part.made_beside])
    document = ezdxf.readfile(path)
    assert document.units == ezdxf.units.MM  # type: ignore[attr-defined]
    for layer, extent in {
        "outline": (-12, -10, 12, 10),
        "window": (-9, -7, 9, 7),
        "seat": (-12.1, -10.1, 12.1, 10.1),
        # 10 mm under the plan: from the apex down to the cover's back at z = -33.5.
        "section": (-15, -53.5, 15, -20),
    }.items():
        box = bbox.extents([e for e in document.modelspace() if e.dxf.layer == layer])
        assert (*box.extmin.vec2, *box.extmax.vec2) == pytest.approx(extent, abs=1e-6)
    corners = [e for e in document.modelspace().query("ARC") if e.dxf.layer == "outline"]
    assert [arc.dxf.radius for arc in corners] == pytest.approx([2.0] * 4)
    # The section of the pad is its profile.
    ((loop,),) = section(gel.solid, "x").faces
    assert loop.min(axis=0) == pytest.approx([-12, -5], abs=1e-6)
    top = loop[loop[:, 1] > -1.4]
    assert PAD.height_mm(top * [1, 0]) == pytest.approx(top[:, 1], abs=1e-6)
    assert circle_through(top) == pytest.approx(50, rel=1e-6)
    assert circle_through(top * [1, 0]) == float("inf")


def texts(path: Path) -> list[str]:
    """What is written on an SVG."""
    found = ET.parse(path).getroot().iter("{http://www.w3.org/2000/svg}text")
    return ["".join(node.itertext()).strip() for node in found]


@pytest.mark.thorough
def test_drawings_state_what_is_built(gel: LabelledSolid, sensor: Assembly, tmp_path: Path) -> None:
    pad, whole = tmp_path / "pad.svg", tmp_path / "all.svg"
    issue = Issue("0a1b2c3d, taccel-lab 9.9", "2031-02-03")
    thickness = {"thickness_mm": (5.0, "mm")}
    pad_drawing(gel, title="test pad", parameters=thickness, material="rubber", issue=issue).save(
        pad
    )
    assembly_drawing(sensor, title="all", notes=["glue the gel"], issue=issue).save(whole)
    root = ET.parse(pad).getroot()
    # A4 in points of 1/72 inch.
    size = [float(root.attrib[key].removesuffix("pt")) for key in ("width", "height")]
    assert size == pytest.approx([297 / 25.4 * 72, 210 / 25.4 * 72], rel=1e-4)
    wall = 5 - (50 - (50**2 - 12**2) ** 0.5)
    assert set(texts(pad)) >= {
        "24", "20", "18 window", "14 window", "4× R2", "R50", "5", f"{wall:.3f} wall",
        "test pad", "rubber", "3:1   (A4)", "thickness_mm", "section A–A", "section B–B",
    }  # fmt: skip
    assert texts(pad).count("R50") == 2
    assert set(texts(whole)) >= {"30", "gap gel_pad - housing: 0.100 mm", "glue the gel"}
    for path, start in (
        (pad, "ISO 3302-1 class"),
        (whole, "ISO 3302-1 class"),
        (whole, "ISO 2768-1 medium"),
        (whole, "2 window (clear acrylic"),
    ):
        assert set(texts(path)) >= {issue.revision, issue.date}
        assert any(start in text for text in texts(path)), start
    # A dome's has diameters and both radii.
    paths = [tmp_path / f"dome.{kind}" for kind in ("svg", "png", "pdf")]
    pad_drawing(labelled_solid(ShellDomePad(skirt_mm=5.0)), title="dome").save(*paths)
    assert set(texts(paths[0])) >= {"Ø30", "Ø27 window", "R15", "R13.5", "1.5", "20", "5 wall"}
    assert paths[1].read_bytes().startswith(b"\x89PNG")
    assert paths[2].read_bytes().startswith(b"%PDF")


def test_drawing_is_the_same_every_time(gel: LabelledSolid, tmp_path: Path) -> None:
    first, second = tmp_path / "a.svg", tmp_path / "b.svg"
    pad_drawing(gel, title="pad").save(first)
    sheet = pad_drawing(gel, title="pad")
    picture = sheet.picture(700)
    sheet.save(second)
    assert first.read_bytes() == second.read_bytes()
    # As an image: white paper with ink, in the sheet's proportions.
    assert picture.shape == (494, 700, 3) and picture.dtype == np.uint8
    assert np.median(picture) == 255 and picture.min() < 50


@pytest.mark.thorough
def test_overlapping_leds_are_red_in_the_plan_and_named(tmp_path: Path) -> None:
    def drawn(y: float) -> tuple[list[str], int]:
        """Texts of two bars at 8 mm and at y, and how many strokes are red."""
        leds = [
            Light((0.0, at, -20.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0), (6.0, 1.0), name=name)
            for name, at in (("one", 8.0), ("two", y))
        ]
        path = tmp_path / "leds.svg"
        assembly_drawing(small_sensor(leds=tuple(leds)), title="leds").save(path)
        return texts(path), path.read_text("utf-8").count("stroke: #c1121f")

    words, red = drawn(5.0)
    assert "red: overlaps another part" not in words and red == 0
    # Both bars miss the section y = 0: the plan shows them.
    words, red = drawn(7.5)
    assert "red: overlaps another part" in words and red == 2
    assert any(text.startswith("led_one and led_two interpenetrate by") for text in words)
