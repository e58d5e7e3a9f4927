# SPDX-License-Identifier: Apache-2.0
"""Gels from triangles and tets: faces found, regions proposed, hostile files refused in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from taccel_lab.cad.export import write_3mf, write_stl
from taccel_lab.cad.gel_import import FaceSelection, import_gel, part_faces
from taccel_lab.cad.gel_import import triangle_gel as module
from taccel_lab.cad.gel_import.patches import faces_of_triangles
from taccel_lab.cad.gel_import.step_gel import facet_solid
from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.mesh.surface import LabelledSurface, check_closed
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.dome_pad import SolidDomePad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.cad.parts.part import gel_part
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.geometry.vtu import write_mesh_vtu
from tests.cad.cubes import FACES, QUADS, UNIT
from tests.support.real_data import real_data

SIZE = np.array([24.0, 20.0, 4.0])
BOX = UNIT * SIZE


def stl(path: Path, points: np.ndarray = BOX, faces: np.ndarray = FACES) -> Path:
    write_stl(LabelledSurface(points, faces, np.zeros(len(faces), np.int32)), path)
    return path


def areas(surface: LabelledSurface) -> dict[str, float]:
    return {r.name: float(surface.areas_mm2()[surface.regions == int(r)].sum()) for r in Region}


def test_a_box_of_triangles_is_proposed_contact_bond_and_window(tmp_path: Path) -> None:
    gel = import_gel(stl(tmp_path / "box.stl"))
    wanted = {"SIDE": 352, "CONTACT": 480, "BOND": 480 - 19.2 * 16, "WINDOW": 19.2 * 16}
    assert areas(gel.surface) == pytest.approx(wanted)
    check_closed(gel.surface.triangles, "the cut surface")
    assert gel.surface.volume_mm3() == pytest.approx(SIZE.prod())
    assert gel.shift_mm == pytest.approx([-12, -10, -4])
    assert gel.thickness_mm == pytest.approx(4) and gel.min_thickness_mm == pytest.approx(4)
    assert gel.assumed["bond"].startswith("plane:-z") and "inside out" not in gel.assumed
    # What is stated turns the rest with it.
    turned = import_gel(tmp_path / "box.stl", FaceSelection(bond=("plane:+y",)))
    assert turned.selection.normal == "-y" and turned.thickness_mm == pytest.approx(20)
    # OBJ and 3MF give the same gel.
    box = facet_solid(gel.surface)
    names = sorted(region.name for region in box.regions)
    assert names == ["BOND", "CONTACT", "SIDE", "SIDE", "SIDE", "SIDE", "WINDOW"]
    write_3mf([gel_part(box)], tmp_path / "box.3mf")
    lines = [f"v {x} {y} {z}" for x, y, z in BOX]
    lines += ["f " + " ".join(str(k + 1) for k in quad) for quad in QUADS]
    (tmp_path / "box.obj").write_text("\n".join(lines))
    for name in ("box.3mf", "box.obj"):
        again = import_gel(tmp_path / name)
        assert areas(again.surface) == pytest.approx(wanted)
        assert again.surface.volume_mm3() == pytest.approx(SIZE.prod())


@pytest.mark.thorough
def test_smooth_faces_end_at_creases_and_where_they_turn_far() -> None:
    """A crowned pad with a fillet, of triangles: no edge of it is sharp but those at the back."""
    pad = GelPad(thickness_mm=5, crown_radius_x_mm=60, crown_radius_y_mm=60, rim="fillet")
    surface = tessellate_solid(labelled_solid(pad), tolerance_mm=0.05, angle_rad=0.2)
    faces = faces_of_triangles(surface.vertices_mm, surface.triangles)
    (back,) = [info for info in faces.table if info.normal[2] < -0.99]
    (top,) = [info for info in faces.table if info.normal[2] > 0.99]
    assert back.kind == "plane" and back.normal == pytest.approx((0, 0, -1))
    assert top.kind == "curved"
    # Down to where the fillet is 60 degrees steep.
    up = surface.normals()[:, 2] > 0.5
    assert top.area_mm2 == pytest.approx(surface.areas_mm2()[up].sum(), rel=0.01)
    assert sum(info.area_mm2 for info in faces.table) == pytest.approx(surface.areas_mm2().sum())
    assert len(faces.table) < 20


@pytest.mark.thorough
def test_a_dome_of_triangles_has_a_back_and_a_recess_to_look_through(tmp_path: Path) -> None:
    surface = tessellate_solid(labelled_solid(SolidDomePad()), tolerance_mm=0.05, angle_rad=0.2)
    write_stl(surface, tmp_path / "dome.stl")
    curved = [info for info in part_faces(tmp_path / "dome.stl").table if info.kind == "curved"]
    (lens,) = [info for info in curved if info.normal[2] < -0.99]
    gel = import_gel(tmp_path / "dome.stl", FaceSelection(window=(f"index:{lens.index}",)))
    glued = surface.vertices_mm[surface.of(Region.BOND, Region.WINDOW)]
    assert gel.thickness_mm == pytest.approx(-glued[..., 2].max(), abs=0.1)
    assert areas(gel.surface)["WINDOW"] == pytest.approx(lens.area_mm2)


@pytest.mark.thorough
def test_good_tets_of_a_file_are_kept_and_others_not(tmp_path: Path) -> None:
    pad = GelPad(
        length_x_mm=12, length_y_mm=10, thickness_mm=3, window_x_mm=8, window_y_mm=6, rim="none",
        crown_radius_x_mm=0, crown_radius_y_mm=0, corner_radius_mm=1,
    )  # fmt: skip
    mesh = gel_mesh(pad, 1.5)
    write_mesh_vtu(tmp_path / "pad.vtu", mesh)
    with pytest.raises(InputError, match=r"numbers look like metres \(12 mm: --unit m\)"):
        import_gel(tmp_path / "pad.vtu")
    gel = import_gel(tmp_path / "pad.vtu", FaceSelection(unit="m", right="+x"))
    assert gel.mesh is not None and gel.mesh.tet_count == mesh.tet_count
    assert gel.mesh.volumes_m3().sum() == pytest.approx(mesh.volumes_m3().sum(), rel=1e-6)
    assert gel.mesh.bonded_nodes().size == mesh.bonded_nodes().size


@pytest.mark.parametrize(
    ("path", "unit"),
    [("gel_STL_model/gelsight_mini.STL", ""), ("tac_sensor_meta/gelsight_mini/tet.msh", "m")],
)
def test_the_gels_of_the_design_track(path: str, unit: str) -> None:
    """25.25 x 20.75 x 4 mm with a bevel of 1 mm at 45 degrees."""
    file = real_data(f"maniskill_vitac2025/Track_3/assets/{path}")
    found = areas(import_gel(file, FaceSelection(unit=unit)).surface)
    x, y, bevel = 25.25, 20.75, 1.0
    assert found["BOND"] + found["WINDOW"] == pytest.approx(x * y)
    assert found["SIDE"] == pytest.approx(2 * (x + y) * (4 - bevel))
    flat = (x - 2 * bevel) * (y - 2 * bevel)
    assert found["CONTACT"] == pytest.approx(flat + (x * y - flat) * np.sqrt(2))


TWO = np.concatenate([BOX, BOX + [50, 0, 0]]), np.concatenate([FACES, FACES + 8])
CROSSED = np.concatenate([BOX[:7], [[12, 10, -3]]])
"""A corner drawn through the opposite side."""
BOOK = np.concatenate([BOX, [[-6.0, -6.0, 2.0]]]), np.concatenate([FACES, [[0, 1, 8]]])
"""Three walls at one edge."""
MIXED = np.concatenate([FACES[:1, ::-1], FACES[1:]])


@pytest.mark.parametrize(
    ("points", "faces", "words"),
    [
        (BOX, FACES[1:], r"is not closed: 3 edges .* Mending .*pymeshlab"),
        (*BOOK, r"(not manifold|not closed).*Mending it fails"),
        (BOX, MIXED, r"oriented differently"),
        (CROSSED, FACES, r"(intersects itself|thick at)"),
        (*TWO, r"holds 2 bodies.*1 \(1920\.0 mm\^3\), 2 \(1920\.0 mm\^3\).*--body"),
        (np.where(BOX == 24, np.nan, BOX), FACES, r"NaN or infinite"),
        (BOX * 1e-3, FACES, r"look like metres \(24 mm: --unit m\)"),
        (BOX * [1, 1, 1e-3], FACES, r"a sheet without volume"),
    ],
)
def test_hostile_surfaces_end_in_a_sentence(
    points: np.ndarray,
    faces: np.ndarray,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without pymeshlab, whose repairs other tests look at."""
    without = Mock(side_effect=InputError("repairing a surface needs pymeshlab"))
    monkeypatch.setattr(module, "read_apart", without)
    with pytest.raises(InputError, match=rf"gel\.stl.*{words}"):
        import_gel(stl(tmp_path / "gel.stl", points, faces))


def test_an_inside_out_surface_is_turned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = stl(tmp_path / "gel.stl", faces=FACES[:, ::-1])
    gel = import_gel(path)
    assert gel.surface.volume_mm3() == pytest.approx(SIZE.prod()) and "inside out" in gel.assumed
    monkeypatch.setattr(module, "MAX_TRIANGLES", 11)
    with pytest.raises(InputError, match=r"12 triangles; a gel may have up to 11: simplify it"):
        import_gel(path)


def test_what_no_gel_can_be_is_refused_when_it_is_read(tmp_path: Path) -> None:
    path = stl(tmp_path / "gel.stl")
    numbers = {info.normal: info.index for info in part_faces(path).table}
    side, bottom = numbers[(1.0, 0.0, 0.0)], numbers[(0.0, 0.0, -1.0)]
    cases: list[tuple[dict[str, Any], str]] = [
        # Glued on a wall that reaches as high as the contact.
        ({"bond": (f"index:{side}",), "window": (f"index:{bottom}",)}, r"contact point lies .* mm"),
        ({"window": ("rect:30x8",)}, r"takes a window of 30 x 8 mm"),
        ({"window": ("plane:+y",), "contact": ("plane:+y",)}, r"for contact and for window"),
    ]
    for given, words in cases:
        with pytest.raises(InputError, match=words):
            import_gel(path, FaceSelection(normal="+z", **given))
    # One of several bodies is chosen by number.
    path = stl(tmp_path / "two.stl", *TWO)
    assert import_gel(path, FaceSelection(body="2")).shift_mm[0] == pytest.approx(-62)
    with pytest.raises(InputError, match=r"none of the number '3'"):
        import_gel(path, FaceSelection(body="3"))


def test_a_window_with_a_hole_is_refused(tmp_path: Path) -> None:
    """A tunnel of 4 x 4 mm leads from the glued back to the contact face."""
    inner = UNIT * [4, 4, 4] + [10, 8, 0]
    walls = FACES[np.ptp(BOX[FACES][..., 2], axis=1) > 0]
    rings = []
    for z, order in ((0, 1), (1, -1)):
        for a, b in ((0, 4), (4, 6), (6, 2), (2, 0)):
            a, b = a + z, b + z
            rings += [[a, b + 8, b][::order], [a, a + 8, b + 8][::order]]
    faces = np.concatenate([walls, walls[:, ::-1] + 8, rings])
    path = stl(tmp_path / "gel.stl", np.concatenate([BOX, inner]), faces)
    with pytest.raises(InputError, match=r"the window has 1 hole, through which"):
        import_gel(path, FaceSelection(window=("plane:-z",), bond=("plane:+x",), normal="+z"))
    with pytest.raises(InputError, match="no window can be proposed"):
        import_gel(path)
