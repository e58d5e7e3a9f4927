# SPDX-License-Identifier: Apache-2.0
"""Surfaces of many triangles stand for solids within a tolerance, or are refused."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from build123d import Solid, export_step

from taccel_lab.cad.export import write_stl
from taccel_lab.cad.gel_import import (
    FaceSelection,
    ImportedGel,
    WorkshopSolid,
    import_gel,
    part_faces,
    workshop_solid,
)
from taccel_lab.cad.mesh.closest import surface_distance
from taccel_lab.cad.mesh.simplify import simplified
from taccel_lab.cad.mesh.surface import LabelledSurface, check_closed
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.moulds import casting_moulds, gel_mould
from taccel_lab.cad.parts.dome_pad import SolidDomePad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.cad.parts.solids import base_outline
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

TOLERANCE_MM = 0.05


@pytest.fixture(scope="module")
def rounded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An STL as CAD programs write it of a pad of 24 x 20 x 4 mm with a fillet."""
    pad = labelled_solid(GelPad(rim="fillet", rim_mm=0.9))
    path = tmp_path_factory.mktemp("rounded") / "rounded.stl"
    write_stl(tessellate_solid(pad, tolerance_mm=0.01, angle_rad=0.1), path)
    return path


@pytest.fixture(scope="module")
def gel(rounded: Path) -> ImportedGel:
    return import_gel(rounded)


@pytest.fixture(scope="module")
def made(gel: ImportedGel) -> WorkshopSolid:
    return workshop_solid(gel)


def test_a_rounded_pad_becomes_a_solid_within_the_tolerance(
    gel: ImportedGel, made: WorkshopSolid
) -> None:
    assert len(gel.surface.triangles) > 9_000
    figures = made.deviation
    assert figures["tolerance_mm"] == TOLERANCE_MM and figures["simplified_triangles"] <= 1_000
    assert 0 < figures["hausdorff_mm"] <= TOLERANCE_MM
    for words in ("file's 9,", f"{figures['hausdorff_mm']:.3f} mm", "Hausdorff", "0.05 mm"):
        assert words in made.faceted
    # The solid itself, against the file.
    solid = tessellate_solid(made.solid, tolerance_mm=0.01, angle_rad=0.1)
    distance, _, _ = surface_distance(
        (solid.vertices_mm, solid.triangles), (gel.surface.vertices_mm, gel.surface.triangles)
    )
    assert distance == pytest.approx(figures["hausdorff_mm"], rel=0.05)
    assert made.solid.volume_mm3 == pytest.approx(gel.surface.volume_mm3(), rel=0.01)
    window = gel.surface.areas_mm2()[gel.surface.regions == int(Region.WINDOW)].sum()
    assert made.solid.area_mm2(Region.WINDOW) == pytest.approx(window)
    base_outline(made.solid.solid)  # Widest where it is glued, as moulds need it.


@pytest.mark.thorough
def test_faces_of_a_mould_are_named_without_measuring_the_whole_gel(
    made: WorkshopSolid, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A distance to all facets for each face took 33 of 42 s of 740 triangles."""
    monkeypatch.setattr(Solid, "distance_to", Mock(side_effect=AssertionError("to all facets")))
    mould = gel_mould(made.solid, facets_mm=TOLERANCE_MM)
    monkeypatch.undo()
    names = list(mould.cavity.face_names)
    # Beside the gel: a top, four walls and their corners, two holes of pins, each with its bottom.
    assert names.count("parting") == 1 and names.count("side") == 1 + 4 + 4 + 2 * 2
    for face in mould.cavity.faces("mould"):
        # The middle of facets that the kernel has merged into one plane lies 0.4 um off it.
        assert mould.body.solid.distance_to(face.center()) < 1e-3
    lid = mould.lid
    assert lid.face_names.count("side") == len(lid.face_names) - 1


@pytest.mark.thorough
def test_walls_of_facets_are_drafted(made: WorkshopSolid) -> None:
    """Facets of a wall lean a little. The wall of 3.1 mm is drafted by 2 degrees, without a gap
    behind the wedge: the mould holds what the gel and its draft have."""
    ((mould, report),) = casting_moulds(made.solid, facets_mm=TOLERANCE_MM)
    assert report.draft_height_mm == pytest.approx(3.1, abs=0.1)
    assert report.draft_width_mm == pytest.approx(np.tan(np.radians(2)) * report.draft_height_mm)
    around_mm = 2 * (24 + 20) - 8 * 2 + 2 * np.pi * 2
    wedge = around_mm * report.draft_height_mm * report.draft_width_mm / 2
    assert report.draft_volume_mm3 == pytest.approx(wedge, rel=0.1)
    assert report.undercut_mm2 < 0.05 and len(mould.body.solid.shells()) == 1


def test_simplified_surfaces_stay_closed_and_glued_in_their_plane(gel: ImportedGel) -> None:
    found = simplified(gel.surface, TOLERANCE_MM, 1_000).surface
    finer = simplified(gel.surface, 0.02, 1_000).surface
    assert len(found.triangles) < len(finer.triangles) <= 1_000
    for surface in (found, finer):
        check_closed(surface.triangles, "simplified")
        glued = surface.vertices_mm[surface.of(Region.BOND, Region.WINDOW)]
        assert np.ptp(glued[..., 2]) < 1e-9
        assert surface.vertices_mm[:, 2].min() == pytest.approx(-4, abs=1e-6)


def test_a_tolerance_that_cannot_be_held_is_refused(gel: ImportedGel) -> None:
    for tolerance, words in (
        (0.004, r"rounded: .*9,\d{3} triangles.*would lie 0\.00\d+ mm off.*at x .*0\.004 mm.*--to"),
        (0.0, r"tolerance_mm must lie in \[0\.001, 1\] mm, got 0"),
    ):
        with pytest.raises(InputError, match=words):
            workshop_solid(gel, tolerance)


def test_few_triangles_are_taken_as_they_are(tmp_path: Path) -> None:
    pad = labelled_solid(GelPad())
    surface = tessellate_solid(pad, tolerance_mm=0.5, angle_rad=0.5)
    write_stl(surface, tmp_path / "few.stl")
    made = workshop_solid(import_gel(tmp_path / "few.stl"), 0.001)
    assert made.faceted.startswith("faces of the file's") and not made.deviation


def area(surface: LabelledSurface, region: Region) -> float:
    return float(surface.areas_mm2()[surface.regions == int(region)].sum())


@pytest.mark.parametrize("thickness_mm", [3.0, 6.0])
def test_a_thickness_moves_the_glued_surface(
    rounded: Path, gel: ImportedGel, thickness_mm: float
) -> None:
    """The base is 24 x 20 mm with corners of 2 mm; the fillet ends 0.9 mm under the apex."""
    moved = import_gel(rounded, FaceSelection(thickness_mm=thickness_mm))
    assert moved.thickness_mm == pytest.approx(thickness_mm)
    for region in (Region.CONTACT, Region.BOND, Region.WINDOW):
        assert area(moved.surface, region) == pytest.approx(area(gel.surface, region))
    base = area(gel.surface, Region.BOND) + area(gel.surface, Region.WINDOW)
    grown = moved.surface.volume_mm3() - gel.surface.volume_mm3()
    assert grown == pytest.approx(base * (thickness_mm - 4))
    assert "glued surface is moved by" in moved.assumed["thickness"]
    assert "thickness" not in gel.assumed


@pytest.mark.parametrize(
    ("thickness_mm", "words"),
    [
        (0.5, r"cannot be 0\.5 mm thick: .* moved by -3\.500 mm, it touches or crosses"),
        (-1.0, r"thickness_mm must lie in \[0\.2, 60\] mm, got -1"),
    ],
)
def test_thicknesses_that_the_shape_does_not_have_are_refused(
    rounded: Path, thickness_mm: float, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        import_gel(rounded, FaceSelection(thickness_mm=thickness_mm))


def test_a_step_gel_of_another_thickness_gets_a_solid_too(tmp_path: Path) -> None:
    export_step(Solid.make_box(8, 7, 3), tmp_path / "box.step")
    faces = {"contact": ("plane:+z",), "bond": ("plane:-z",), "window": ("rect:5x4",)}
    moved = import_gel(tmp_path / "box.step", FaceSelection(**faces, thickness_mm=2.0))
    assert moved.part is None and moved.thickness_mm == pytest.approx(2)
    solid = workshop_solid(moved).solid
    assert solid.volume_mm3 == pytest.approx(8 * 7 * 2)
    assert solid.area_mm2(Region.WINDOW) == pytest.approx(20)
    assert solid.area_mm2(Region.BOND) == pytest.approx(8 * 7 - 20)


@pytest.mark.thorough
def test_a_curved_bond_moves_as_it_is(tmp_path: Path) -> None:
    """A dome with a lens in its back, which the camera looks through."""
    surface = tessellate_solid(labelled_solid(SolidDomePad()), tolerance_mm=0.05, angle_rad=0.2)
    write_stl(surface, tmp_path / "dome.stl")
    curved = [info for info in part_faces(tmp_path / "dome.stl").table if info.kind == "curved"]
    (lens,) = [info for info in curved if info.normal[2] < -0.99]
    window = (f"index:{lens.index}",)
    gel = import_gel(tmp_path / "dome.stl", FaceSelection(window=window))
    wanted = gel.thickness_mm - 0.4
    thin = import_gel(tmp_path / "dome.stl", FaceSelection(window=window, thickness_mm=wanted))
    shift = thin.surface.vertices_mm - gel.surface.vertices_mm
    glued = np.unique(gel.surface.of(Region.BOND, Region.WINDOW))
    assert shift[glued] == pytest.approx(np.tile([0, 0, 0.4], (len(glued), 1)))
    assert not np.delete(shift, glued, axis=0).any()
    assert (thin.surface.regions == gel.surface.regions).all()
