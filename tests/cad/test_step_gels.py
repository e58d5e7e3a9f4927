# SPDX-License-Identifier: Apache-2.0
"""A STEP file comes back with its regions; bodies that cannot be gels are refused in words."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from build123d import Compound, Face, Location, Plane, Shell, Solid, Wire, export_step
from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
from OCP.StdFail import StdFail_NotDone
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

from taccel_lab.cad.export import write_assembly_step, write_step
from taccel_lab.cad.gel_import import FaceSelection, gel_file, import_gel, part_faces, step_gel
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.mesh.tetrahedralize import tetwild_mesh
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.cad.parts.part import LabelledSolid
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from tests.cad.small_sensor import PAD, small_sensor
from tests.support.real_data import real_data
from tests.support.sensor_refusals import refuses

BOX = FaceSelection(contact=("plane:+z",), bond=("plane:-z",), window=("rect:10x8",))


def write(shape: object, path: Path) -> Path:
    export_step(shape, path)  # type: ignore[arg-type]
    return path


def box(x: float = 24.0, y: float = 20.0, z: float = 4.0) -> Solid:
    return Solid.make_box(x, y, z, Plane((-x / 2, -y / 2, -z)))


def areas(part: LabelledSolid) -> dict[str, float]:
    return {region.name: part.area_mm2(region) for region in Region}


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> tuple[LabelledSolid, Path]:
    path = tmp_path_factory.mktemp("step") / "pad.step"
    part = labelled_solid(PAD)
    write_step(part, path)
    return part, path


@pytest.fixture(scope="module")
def box_step(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(box(), tmp_path_factory.mktemp("box") / "box.step")


NAMES_TOML = 'contact = "name:cont*"\nbond = ["name:bond"]\nwindow = ["name:window"]\n'
BY_COLOUR = FaceSelection(
    contact=("color:#E68C33",), bond=("color:336bb3",), window=("color:73c7d9",)
)


@pytest.mark.parametrize("selected", ["", "colours", "toml"])
def test_our_step_is_read(selected: str, own: tuple[LabelledSolid, Path], tmp_path: Path) -> None:
    part, path = own
    (tmp_path / "faces.toml").write_text(NAMES_TOML)
    by_name = FaceSelection.from_toml(tmp_path / "faces.toml")
    gel = import_gel(path, {"": None, "colours": BY_COLOUR, "toml": by_name}[selected])
    assert gel.part.regions == part.regions
    assert areas(gel.part) == pytest.approx(areas(part), rel=1e-6)
    assert gel.part.volume_mm3 == pytest.approx(part.volume_mm3, rel=1e-8)
    assert gel.shift_mm == pytest.approx([0, 0, 0], abs=1e-6)
    assert gel.thickness_mm == pytest.approx(5.0, abs=1e-6)
    assert gel.min_thickness_mm == pytest.approx(5 - 2.24, abs=0.15)
    assert gel.name == "gel_pad"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            'kontakt = "name:contact"',
            r"kontakt: unknown key \(did you mean contact\?\); allowed: body, bond",
        ),
        ("contact = 3", r"faces.toml: contact: a list in square brackets is needed \(found 3\)"),
    ],
)
def test_files_of_a_selection_are_checked(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "faces.toml").write_text(text)
    with pytest.raises(InputError, match=words):
        FaceSelection.from_toml(tmp_path / "faces.toml")


def test_a_dome_comes_back_too(tmp_path: Path) -> None:
    part = labelled_solid(ShellDomePad())
    write_step(part, tmp_path / "dome.step")
    gel = import_gel(tmp_path / "dome.step", FaceSelection(origin="file"))
    assert areas(gel.part) == pytest.approx(areas(part), rel=1e-6)
    assert gel.thickness_mm == pytest.approx(1.5, abs=1e-3)
    assert gel.min_thickness_mm == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize(
    ("normal", "right", "frame"),
    [
        ("+y", "", Plane((0.3, 5, -0.2), x_dir=(1, 0, 0), z_dir=(0, 1, 0))),
        ("-z", "-x", Plane((1, 2, 3), x_dir=(-1, 0, 0), z_dir=(0, 0, -1))),
        ("+x", "", Plane((7, 0, 0), x_dir=(0, 1, 0), z_dir=(1, 0, 0))),
    ],
)
def test_the_body_is_turned_into_the_gel_frame(
    normal: str, right: str, frame: Plane, own: tuple[LabelledSolid, Path], tmp_path: Path
) -> None:
    part, _ = own
    moved = LabelledSolid((frame.location * part.solid).solids()[0], part.regions)
    path = write(moved.solid, tmp_path / "moved.step")
    listed = part_faces(path).table
    window, bond = (part.regions.index(region) for region in (Region.WINDOW, Region.BOND))
    assert listed[window].area_mm2 == pytest.approx(252)
    selection = FaceSelection(
        contact=(f"normal:{normal}",), bond=(f"index:{bond}",), window=(f"index:{window}",),
        normal=normal, right=right,
    )  # fmt: skip
    gel = import_gel(path, selection)
    low, high = gel.part.solid.bounding_box().min, gel.part.solid.bounding_box().max
    assert (low.X, low.Y, low.Z) == pytest.approx((-12, -10, -5), abs=1e-5)
    assert (high.X, high.Y, high.Z) == pytest.approx((12, 10, 0), abs=1e-5)
    assert np.linalg.det(gel.rotation) == pytest.approx(1)
    assert gel.part.regions == part.regions
    # A point of the file goes where the body went.
    center = moved.solid.center()
    found = gel.rotation @ np.array([center.X, center.Y, center.Z]) + gel.shift_mm
    assert found == pytest.approx(tuple(part.solid.center()), abs=1e-5)


def test_a_window_is_split_off_the_glued_plane_and_proposed(box_step: Path) -> None:
    gel = import_gel(box_step, BOX)
    wanted = {"SIDE": 2 * (24 + 20) * 4, "CONTACT": 480, "BOND": 400, "WINDOW": 80}
    assert areas(gel.part) == pytest.approx(wanted)
    assert gel.part.volume_mm3 == pytest.approx(24 * 20 * 4)
    (window,) = gel.part.faces(Region.WINDOW)
    assert tuple(window.center()) == pytest.approx((0, 0, -4), abs=1e-6)
    # Without names it is proposed.
    gel = import_gel(box_step)
    assert areas(gel.part)["CONTACT"] == pytest.approx(480)
    assert gel.selection.window == ("rect:19.2x16",)
    assert {"contact", "bond", "window", "normal"} <= set(gel.assumed)
    with pytest.raises(InputError) as caught:
        import_gel(box_step, FaceSelection(contact=("name:contact",)))
    for words in (
        "'name:contact' matches none of the 6 faces", "normal (0.00, 0.00, 1.00)", "480.000 mm^2",
        "names in the file: none at all; select by plane:, normal: or index:",
    ):  # fmt: skip
        assert words in str(caught.value)


test_bad_selections_are_refused = refuses(
    lambda path, changes: import_gel(path, FaceSelection(**{**vars(BOX), **changes})),
    ({"contact": ("top",)}, r"'top' selects no faces; write one of name:NAME"),
    ({"contact": ("index:6",)}, r"numbered 0 to 5"),
    ({"contact": ("index:2-1",)}, r"numbered 0 to 5"),
    ({"contact": ("index:a",)}, r"whole numbers"),
    ({"contact": ("plane:up",)}, r"'up' is not a direction"),
    ({"contact": ("normal:+z@x",)}, r"degrees after @"),
    ({"contact": ("normal:-z",)}, r"face \d is selected for contact and for bond"),
    ({"bond": ("rect:3x3",)}, r"allowed for the window only"),
    ({"window": ("rect:30x8",)}, r"takes a window of 30 x 8 mm"),
    ({"window": ("rect:3",)}, r"must stand alone and read rect:18x14"),
    ({"window": ()}, r"no faces are selected for window"),
    ({"normal": "z+"}, r"'z\+' is not a direction"),
    ({"right": "-z"}, r"right = -z lies along normal"),
    ({"origin": "corner"}, r"no origin 'corner'.*known: center, file"),
    ({"body": "lid"}, r"0 solids of the name 'lid'"),
    given="box_step",
)


def test_bad_bodies_are_refused_and_large_ones_not_meshed(tmp_path: Path) -> None:
    two = box().solids() + [Solid.make_box(5, 5, 5, Plane((50, 0, 0)))]
    open_shell = Shell(box().faces()[:5])
    bow = Face(Wire.make_polygon([(0, 0, 0), (20, 10, 0), (20, 0, 0), (0, 12, 0)], close=True))
    cases = [
        (Compound(children=two), r"holds 2 solids; one is needed.*--body, by name or number"),
        (Shell(box().faces()), r"no solid: the surface is closed\. Export a solid"),
        (open_shell, r"no solid: the surface is open at 4 edges"),
        (Solid.extrude(bow, (0, 0, 4)), r"intersects itself"),
        (box(0.024, 0.02, 0.004), r"look like metres"),
        (box(24, 20, 0.01), r"a sheet without volume"),
    ]
    for shape, words in cases:
        with pytest.raises(InputError, match=words):
            import_gel(write(shape, tmp_path / "bad.step"), BOX)
    fin = (box() + Solid.make_box(0.02, 10, 3, Plane((11.0, -5, 0)))).solids()[0]
    selection = BOX.model_copy(update={"contact": ("normal:+z",)})
    with pytest.raises(InputError, match=r"0\.02 mm thick at x 11\.0"):
        import_gel(write(fin, tmp_path / "fin.step"), selection)
    path = write(box(600, 500, 100), tmp_path / "large.step")
    large = import_gel(path, BOX.model_copy(update={"unit": "mm"})).part
    with pytest.raises(InputError, match=r"edge_mm = 2 would make about 3.2e\+07 tets.* needed"):
        tetwild_mesh(tessellate_solid(large), 2.0)
    (tmp_path / "no.step").write_text("not a STEP file")
    for name, words in (("no", "not a STEP file"), ("missing", "does not exist")):
        with pytest.raises(InputError, match=words):
            import_gel(tmp_path / f"{name}.step", BOX)


def entity(text: str, name: str, fields: str) -> str:
    """The text of a STEP file with other fields in its first entity of a name; # is its own id."""
    match = re.search(rf"#(\d+) = {name}\(([^;]*)\);", text)
    assert match is not None
    fields = fields.replace("#", f"#{match[1]}")
    return text[: match.start()] + f"#{match[1]} = {name}({fields});" + text[match.end() :]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        # The kernel follows it in circles until its stack ends; kept seeds of damage crash it, too.
        pytest.param(
            lambda t: entity(t, "ADVANCED_FACE", "'',(#),#,.F."),
            r"cadquery-ocp\S* \d+\.\d+\S* crashed on it",
            marks=pytest.mark.slow,
        ),
        (lambda t: t.replace("(-12.,", "(nan,"), "no finite bounding box"),
    ],
)
def test_damage_is_a_sentence(damage: Callable[[str], str], words: str, tmp_path: Path) -> None:
    path = write(box(), tmp_path / "box.step")
    path.write_text(damage(path.read_text()))
    with pytest.raises(InputError, match=rf"box\.step.*{words}") as caught:
        import_gel(path, BOX)
    assert "is damaged" not in str(caught.value)


@pytest.mark.thorough
def test_files_that_are_large_or_take_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(box(), tmp_path / "box.step")
    monkeypatch.setattr(gel_file, "LIMIT_S", 1e-3)
    with pytest.raises(InputError, match=r"box\.step: the reader did not finish within 0\.001 s"):
        import_gel(path, BOX)
    monkeypatch.setattr(gel_file, "MAX_BYTES", 1000)
    for read in (import_gel, part_faces):
        with pytest.raises(InputError, match=r"box\.step has .* KiB; a STEP file .* 1000 bytes"):
            read(path)


def test_exceptions_of_the_kernel_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for error, raised in ((StdFail_NotDone("no"), InputError), (KeyError("no"), KeyError)):
        monkeypatch.setattr(step_gel, "read_step", Mock(side_effect=error))
        with pytest.raises(raised, match="no"):
            step_gel.gel_of_step(tmp_path / "x.step", BOX)


@pytest.mark.thorough
def test_this_process_lists_faces_without_the_kernel(box_step: Path) -> None:
    code = (
        "import sys; from taccel_lab.cad.gel_import import part_faces\n"
        f"print(len(part_faces({str(box_step)!r}).table), 'OCP' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["6", "False"]


def test_one_body_of_an_assembly_is_chosen_by_name(tmp_path: Path) -> None:
    sensor = small_sensor(housing=None, cameras=(), leds=())
    path = tmp_path / "assembly.step"
    write_assembly_step(sensor.parts[:2], path, name="sensor")
    with pytest.raises(InputError, match=r"2 solids; one is needed.*gel_pad"):
        import_gel(path)
    gel = import_gel(path, FaceSelection(body="gel_pad"))
    assert gel.part.volume_mm3 == pytest.approx(labelled_solid(PAD).volume_mm3, rel=1e-6)


def assembly_of_one_part(path: Path, named: tuple[str, ...]) -> list[np.ndarray]:
    """A plate with a red top, five times: twice in a group, that is there twice, and once alone.
    Returns where the file puts each, [4, 4] [mm]."""
    document = TDocStd_Document(TCollection_ExtendedString("XCAF"))
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    XCAFDoc_ShapeTool.SetAutoNaming_s(False)
    plate = Solid.make_box(20, 16, 4)
    part = shapes.AddShape(plate.wrapped, False)
    top = max(plate.faces(), key=lambda face: face.center().Z)
    red = Quantity_Color(1, 0, 0, Quantity_TypeOfColor.Quantity_TOC_sRGB)
    colors = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    colors.SetColor(shapes.AddSubShape(part, top.wrapped), red, XCAFDoc_ColorType.XCAFDoc_ColorSurf)
    group, whole = shapes.NewShape(), shapes.NewShape()
    in_group = [Location((0, 0, 0)), Location((40, 0, 0), (0, 0, 90))]
    in_whole = [Location((0, 0, 0)), Location((0, 0, 50), (180, 0, 30))]
    for place in in_group:
        shapes.AddComponent(group, part, place.wrapped)
    for place in in_whole:
        shapes.AddComponent(whole, group, place.wrapped)
    alone = Location((0, 60, 0), (0, 90, 0))
    shapes.AddComponent(whole, part, alone.wrapped)
    for name, label in (("plate", part), ("group", group), ("whole", whole)):
        if name in named:
            TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))
    shapes.UpdateAssemblies()
    writer = STEPCAFControl_Writer()
    writer.Transfer(document)
    writer.Write(str(path))
    places = [outer * inner for outer in in_whole for inner in in_group] + [alone]
    moves = [place.wrapped.Transformation() for place in places]
    return [np.array([[m.Value(r, c) for c in (1, 2, 3, 4)] for r in (1, 2, 3)]) for m in moves]


@pytest.mark.parametrize("named", [(), ("plate",), ("plate", "group", "whole")])
def test_parts_of_an_assembly_are_found_in_place(named: tuple[str, ...], tmp_path: Path) -> None:
    """Its repeated labels have no names, on which the kernel crashed."""
    path = tmp_path / "assembly.step"
    places = assembly_of_one_part(path, named)
    with pytest.raises(InputError, match=r"5 solids; one is needed(.*\(1280\.0 mm\^3\)){5}"):
        part_faces(path)
    for number, place in enumerate(places, 1):
        faces = part_faces(path, str(number)).table
        (top,) = [face for face in faces if face.color == "ff0000"]
        assert top.center_mm == pytest.approx(place @ [10, 8, 4, 1], abs=1e-6)
        assert top.normal == pytest.approx(place[:, 2], abs=1e-9)
    gel = import_gel(path, BOX.model_copy(update={"contact": ("color:ff0000",), "body": "1"}))
    assert gel.part.volume_mm3 == pytest.approx(1280)
    assert gel.part.area_mm2(Region.CONTACT) == pytest.approx(320)


@pytest.mark.thorough
def test_the_gel_of_a_gelsight_mini_is_imported() -> None:
    """25.25 x 20.75 x 4.00 mm, 1898.81 mm^3, as measured by its authors."""
    selection = FaceSelection(
        contact=("normal:+y",), bond=("plane:-y",), window=("rect:18x14",), normal="+y"
    )
    path = real_data("sensor_geometry/gelsight_mini/gelsight_mini_gel_feats.step")
    gel = import_gel(path, selection)
    size = gel.part.solid.bounding_box().size
    assert (size.X, size.Y, size.Z) == pytest.approx((25.25, 20.75, 4.0), abs=2e-3)
    assert gel.part.volume_mm3 == pytest.approx(1898.81, abs=0.05)
    assert gel.part.area_mm2(Region.BOND) == pytest.approx(522.006 - 252, abs=1e-2)
    perimeter = 2 * (25.25 + 20.75) - (8 - 2 * np.pi) * 1.5
    assert gel.part.area_mm2(Region.SIDE) == pytest.approx(2.75 * perimeter, rel=2e-3)
