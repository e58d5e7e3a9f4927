# SPDX-License-Identifier: Apache-2.0
"""Files for the workshop read back by other programs' readers: names, colours, sizes."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import ezdxf
import numpy as np
import pytest
from build123d import Mesher, Unit
from ezdxf import bbox

from taccel_lab.cad.assembly import Assembly
from taccel_lab.cad.drawing.assembly_drawing import assembly_drawing
from taccel_lab.cad.drawing.pad_drawing import pad_drawing
from taccel_lab.cad.drawing.sections import circle_through, section
from taccel_lab.cad.drawing.title import Issue
from taccel_lab.cad.export import (
    write_3mf,
    write_assembly_step,
    write_dxf,
    write_part_step,
    write_part_stl,
)
from taccel_lab.cad.gel_import.step_reader import read_step
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.cad.parts.part import LabelledSolid
from taccel_lab.profile.optical_design import Light
from tests.cad.small_sensor import PAD, small_sensor


@pytest.fixture(scope="module")
def sensor() -> Assembly:
    return small_sensor()


@pytest.fixture(scope="module")
def gel() -> LabelledSolid:
    return labelled_solid(PAD)


@pytest.mark.thorough
def test_assembly_step_keeps_names_colours_faces_and_places(
    sensor: Assembly, tmp_path: Path
) -> None:
    path = tmp_path / "assembly.step"
    write_assembly_step(sensor.parts, path, name=sensor.name)
    bodies = {body.name: body for body in read_step(path)}
    assert list(bodies) == [part.name for part in sensor.parts]
    for part in sensor.parts:
        body = bodies[part.name]
        assert body.shape.volume == pytest.approx(part.solid.volume, rel=1e-6)
        assert tuple(body.shape.bounding_box().min) == pytest.approx(
            tuple(part.solid.bounding_box().min), abs=1e-5
        )
        assert Counter(body.face_names) == Counter(part.face_names)
        by_name = dict(zip(body.face_names, body.face_colors, strict=True))
        for name in set(part.face_names):
            color = [int(by_name[name][k : k + 2], 16) / 255 for k in (0, 2, 4)]
            assert color == pytest.approx(part.face_color(name), abs=0.005), (part.name, name)
    products = re.findall(r"=PRODUCT\('([^']*)'", path.read_text().replace(" ", ""))
    assert set(products) == {"small", *bodies}


@pytest.mark.thorough
def test_parts_alone_are_written_in_their_own_frame(sensor: Assembly, tmp_path: Path) -> None:
    import pyvista as pv

    window = sensor.part("window")
    write_part_step(window, tmp_path / "window.step")
    (body,) = read_step(tmp_path / "window.step")
    assert body.shape.bounding_box().max.Z == pytest.approx(0, abs=1e-6)
    assert Counter(body.face_names) == Counter(window.face_names)
    write_part_stl(window, tmp_path / "window.stl")
    surface = pv.read(tmp_path / "window.stl")
    assert isinstance(surface, pv.PolyData)
    assert surface.volume == pytest.approx(window.solid.volume, rel=1e-4)
    assert surface.bounds[5] == pytest.approx(0, abs=1e-6)


@pytest.mark.thorough
def test_3mf_holds_named_bodies_in_millimetres(sensor: Assembly, tmp_path: Path) -> None:
    path = tmp_path / "sensor.3mf"
    write_3mf(sensor.parts, path)
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
        volume = np.linalg.det(corners).sum() / 6
        # Chords of 0.06 rad under the crown of radius 50 mm cost up to 0.02 mm of height.
        assert volume == pytest.approx(part.solid.volume, rel=3e-3)
        group, index, _ = body.GetObjectLevelProperty()
        material = reader.model.GetBaseMaterialGroupByID(group)
        color = reader.wrapper.ColorToFloatRGBA(material.GetDisplayColor(index))
        assert color[:3] == pytest.approx(part.color, abs=0.01)
    assert not found.MoveNext()


def test_dxf_has_outline_window_seat_and_section_to_scale(
    gel: LabelledSolid, sensor: Assembly, tmp_path: Path
) -> None:
    path = tmp_path / "pad.dxf"
    write_dxf(gel, path, others=[part for part in sensor.parts if part.made_beside])
    document = ezdxf.readfile(path)
    assert document.units == ezdxf.units.MM  # type: ignore[attr-defined]
    extents = {}
    for layer in ("outline", "window", "seat", "section"):
        entities = [e for e in document.modelspace() if e.dxf.layer == layer]
        box = bbox.extents(entities)
        extents[layer] = (*box.extmin.vec2, *box.extmax.vec2)
    assert extents["outline"] == pytest.approx((-12, -10, 12, 10), abs=1e-6)
    assert extents["window"] == pytest.approx((-9, -7, 9, 7), abs=1e-6)
    assert extents["seat"] == pytest.approx((-12.1, -10.1, 12.1, 10.1), abs=1e-6)
    # 10 mm under the plan: from the apex down to the cover's back at z = -33.5.
    assert extents["section"] == pytest.approx((-15, -53.5, 15, -20), abs=1e-6)
    corners = [e for e in document.modelspace().query("ARC") if e.dxf.layer == "outline"]
    assert [arc.dxf.radius for arc in corners] == pytest.approx([2.0] * 4)


def texts(path: Path) -> list[str]:
    """What is written on an SVG."""
    found = ET.parse(path).getroot().iter("{http://www.w3.org/2000/svg}text")
    return ["".join(node.itertext()).strip() for node in found]


@pytest.mark.thorough
def test_drawing_states_the_dimensions_of_the_solid(gel: LabelledSolid, tmp_path: Path) -> None:
    path = tmp_path / "pad.svg"
    parameters = {"thickness_mm": (5.0, "mm")}
    pad_drawing(gel, title="test pad", parameters=parameters, material="rubber").save(path)
    root = ET.parse(path).getroot()
    # A4 in points of 1/72 inch.
    size = [float(root.attrib[key].removesuffix("pt")) for key in ("width", "height")]
    assert size == pytest.approx([297 / 25.4 * 72, 210 / 25.4 * 72], rel=1e-4)
    words = texts(path)
    wall = 5 - (50 - (50**2 - 12**2) ** 0.5)
    for wanted in (
        "24", "20", "18 window", "14 window", "4× R2", "R50", "5", f"{wall:.3f} wall",
        "test pad", "rubber", "3:1   (A4)", "thickness_mm", "section A–A", "section B–B",
    ):  # fmt: skip
        assert wanted in words, (wanted, words)
    assert words.count("R50") == 2


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
def test_drawing_of_a_dome_states_diameters_and_both_radii(tmp_path: Path) -> None:
    paths = [tmp_path / "dome.svg", tmp_path / "dome.png", tmp_path / "dome.pdf"]
    pad_drawing(labelled_solid(ShellDomePad(skirt_mm=5.0)), title="dome").save(*paths)
    words = texts(paths[0])
    for wanted in ("Ø30", "Ø27 window", "R15", "R13.5", "1.5", "20", "5 wall"):
        assert wanted in words, (wanted, words)
    assert paths[1].read_bytes().startswith(b"\x89PNG")
    assert paths[2].read_bytes().startswith(b"%PDF")


@pytest.mark.thorough
def test_assembly_drawing_lists_parts_gaps_and_sizes(sensor: Assembly, tmp_path: Path) -> None:
    path = tmp_path / "assembly.svg"
    assembly_drawing(sensor, title="small sensor", notes=["glue the gel"]).save(path)
    words = texts(path)
    assert "30" in words and "gap gel_pad - housing: 0.100 mm" in words
    assert any(text.startswith("2 window (clear acrylic") for text in words)
    assert "glue the gel" in words


@pytest.mark.thorough
def test_drawings_state_revision_date_and_tolerances(
    gel: LabelledSolid, sensor: Assembly, tmp_path: Path
) -> None:
    issue = Issue("0a1b2c3d, taccel-lab 9.9", "2031-02-03")
    pad_drawing(gel, title="pad", issue=issue).save(tmp_path / "pad.svg")
    assembly_drawing(sensor, title="all", issue=issue).save(tmp_path / "all.svg")
    for name in ("pad.svg", "all.svg"):
        words = texts(tmp_path / name)
        assert issue.revision in words and issue.date in words, words
        assert any("ISO 3302-1 class" in text for text in words)
    assert any("ISO 2768-1 medium" in text for text in words)


@pytest.mark.thorough
def test_overlapping_leds_are_red_in_the_plan_and_named(tmp_path: Path) -> None:
    def bar(name: str, x: float, y: float) -> Light:
        return Light((x, y, -20.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0), (6.0, 1.0), name=name)

    apart, crossed = tmp_path / "apart.svg", tmp_path / "crossed.svg"
    for path, shift in ((apart, 3.0), (crossed, 0.5)):
        leds = (bar("one", 0.0, 8.0), bar("two", 0.0, 8.0 - shift))
        assembly_drawing(small_sensor(leds=leds), title="leds").save(path)
    assert "red: overlaps another part" not in texts(apart) and "#c1121f" not in apart.read_text(
        "utf-8"
    )
    words = texts(crossed)
    assert "red: overlaps another part" in words
    assert any(text.startswith("led_one and led_two interpenetrate by") for text in words)
    # Both bars miss the section y = 0: the plan shows them.
    assert crossed.read_text("utf-8").count("stroke: #c1121f") == 2


def test_section_of_the_pad_is_its_profile(gel: LabelledSolid) -> None:
    cut = section(gel.solid, "x")
    ((loop,),) = cut.faces
    assert loop.min(axis=0) == pytest.approx([-12, -5], abs=1e-6)
    top = loop[loop[:, 1] > -1.4]
    assert PAD.height_mm(top * [1, 0]) == pytest.approx(top[:, 1], abs=1e-6)
    assert circle_through(top) == pytest.approx(50, rel=1e-6)
    assert circle_through(top * [1, 0]) == float("inf")
