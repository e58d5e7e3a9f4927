# SPDX-License-Identifier: Apache-2.0
"""A gel from a STEP file becomes the same files as a design, or is refused before anything."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from build123d import Plane, Solid, export_step

from taccel_lab.cad.gel_import import FaceSelection
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.presses import (
    PressPath,
    PressSetup,
    SeenFrom,
    parse_indenter,
    profile_material,
    simulate_press,
)
from taccel_lab.presses.mesh import pad_press_mesh, refined_press_mesh
from taccel_lab.profile import load_profile
from taccel_lab.sensors.imported import ImportResult, import_design
from taccel_lab.sensors.registry import profile_parameters, sensor_family
from tests.geometry.vtu_files import read_mesh_vtu

SELECTION = FaceSelection(contact=("plane:+z",), bond=("plane:-z",), window=("rect:5x4",))


@pytest.fixture
def step(tmp_path: Path) -> Path:
    path = tmp_path / "mine.step"
    export_step(Solid.make_box(8, 7, 3, Plane((2, 0, 0))), path)
    return path


@pytest.mark.thorough
def test_a_block_is_imported(step: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(tmp_path / "cache"))
    done: list[tuple[str, int, int]] = []
    progress = lambda *step: done.append(step)  # noqa: E731
    result = import_design(step, SELECTION, tmp_path / "out", 1.5, progress=progress)
    assert set(result.files) == {
        "mesh", "quality", "gel", "faces", "preview", "profile", "step", "stl", "3mf", "dxf",
        "mould_cavity", "mould_lid", "mould_3mf", "mould_report", "drawing", "drawing_pdf",
    }  # fmt: skip
    assert all(path.exists() for path in result.files.values())
    assert done[:3] == [("import", 0, 1), ("import", 1, 1), ("cad", 0, 1)]
    written = json.loads(result.files["gel"].read_text())
    assert written["file"] == "mine.step" and written["thickness_mm"] == pytest.approx(3.0)
    assert written["selection"]["window"] == ["rect:5x4"]
    assert set(written["assumed"]) == {"normal", "right", "origin", "unit"}
    assert written["assumed"]["right"] == "+x of the file becomes the gel's x"
    assert np.array(written["gel_from_file"]["rotation_and_scale"]) == pytest.approx(np.eye(3))
    assert written["gel_from_file"]["shift_mm"] == pytest.approx([-6, -3.5, -3], abs=1e-6)
    mesh, quality = read_mesh_vtu(result.files["mesh"]), result.quality
    assert mesh.volumes_m3().sum() * 1e9 == pytest.approx(8 * 7 * 3, rel=5e-3)
    areas = quality.region_areas_mm2
    assert areas["window"] == pytest.approx(20, rel=0.2)
    assert areas["window"] + areas["bond"] == pytest.approx(56, rel=0.02)
    assert areas["contact"] == pytest.approx(56, rel=0.02)
    assert quality.min_dihedral_deg >= 10 and quality.back_plane_error_mm < 1e-6


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> ImportResult:
    folder = tmp_path_factory.mktemp("imported")
    export_step(Solid.make_box(14, 12, 4), folder / "my gel.step")
    values = {"young_modulus_mpa": 0.2, "width_px": 200}
    return import_design(
        folder / "my gel.step", SELECTION, folder / "out", like="gelsight_mini",
        overrides=values, parts=(),
    )  # fmt: skip


@pytest.mark.thorough
def test_an_imported_gel_has_a_profile(imported: ImportResult) -> None:
    profile = load_profile(imported.files["profile"])
    assert profile.sensor.family == "imported" and profile.gel.thickness_mm == pytest.approx(4.0)
    assert profile.material.young_modulus_pa == pytest.approx(2e5)
    assert profile.grid().width_px == 200
    assert profile.optics is not None and profile.window is not None
    assert profile.window.size_mm == pytest.approx((14, 12), abs=1e-6)
    for key, block in profile.blocks().items():
        kind = "designed" if key in ("sensor", "gel") else "assumed"
        assert block.provenance.kind == kind, key
    provenance = profile.sensor.provenance
    assert "like gelsight_mini with young_modulus_mpa = 0.2" in provenance.source
    assert list(provenance.inputs) == ["my gel.step"]


@pytest.mark.thorough
def test_a_press_on_an_imported_gel_is_that_on_the_same_pad(imported: ImportResult) -> None:
    """The catalogue's flat pad of the same size, edges sharp: a ball of 2 mm, 0.4 mm deep."""
    values = {"length_x_mm": 14, "length_y_mm": 12, "thickness_mm": 4, "corner_radius_mm": 0.3}
    parameters = sensor_family("flat_pad").parameters({**values, "width_px": 160, "height_px": 120})
    ball, at_mm, profile = parse_indenter("sphere:2"), (1.0, -0.5), imported.profile
    material = profile_material(profile.material, imported.mesh)
    forces = []
    for mesh in (
        refined_press_mesh(profile_parameters(profile).pad(), at_mm, ball.contact(0.4)),
        pad_press_mesh(parameters.pad(), at_mm, ball.contact(0.4)),
    ):
        outcome = simulate_press(
            PressSetup(mesh, material, ball, 0.5), at_mm, PressPath(0.4), SeenFrom(profile.grid())
        )
        forces.append(outcome.figures()["force_n"])
    assert forces[0] == pytest.approx(forces[1], rel=0.02)


@pytest.mark.thorough(cases=("edge:90x6x0.1-0.1915-60000", "sphere:2-0.76-10000"))
@pytest.mark.parametrize(
    ("tool", "radius_mm", "most"),
    [("sphere:2", 0.76, 10_000), ("cylinder:2", 2.0, 10_000), ("edge:90x6x0.1", 0.1915, 60_000)],
)
def test_the_mesh_of_a_press_is_fine_at_the_tool_alone(
    imported: ImportResult, tool: str, radius_mm: float, most: int
) -> None:
    """No run of fTetWild makes the gel's mesh of another, so it is held against what is asked for
    at the tool, of a contact of this radius or half width, and against the gel's own far away."""
    pad = profile_parameters(imported.profile).pad()
    mesh = refined_press_mesh(pad, (0.0, 0.0), parse_indenter(tool).contact(0.3))
    # An edge's 6 mm asked for 33,000 to 39,400 in ten runs.
    assert imported.mesh.tet_count < mesh.tet_count < most
    corners = 1e3 * mesh.nodes_m[mesh.tets]
    longest_mm = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=-1).max(axis=(1, 2))
    size_mm = 1.8 * radius_mm * 0.3
    from_middle_mm = np.linalg.norm(corners.mean(axis=1), axis=1)
    at_tool = from_middle_mm < 0.75 * size_mm  # One holds the middle, and its own is so close.
    asked_mm = size_mm + np.maximum(from_middle_mm - 0.3 * radius_mm, 0.0)
    assert at_tool.any()
    assert (longest_mm <= asked_mm)[at_tool].all()
    assert spacing_beside_mm(mesh) > 0.85 * spacing_beside_mm(imported.mesh)


def spacing_beside_mm(mesh: TetMesh) -> float:
    """Edge of regular tets as large as those more than 5 mm beside tools along y."""
    beside = np.abs(mesh.nodes_m[mesh.tets].mean(axis=1)[:, 0]) > 5e-3
    return 1e3 * float(np.median(np.cbrt(6 * np.sqrt(2) * mesh.volumes_m3()[beside])))


def test_presses_beside_an_imported_gel_are_refused(imported: ImportResult) -> None:
    with pytest.raises(InputError, match=r"ends .* mm away from"):
        refined_press_mesh(profile_parameters(imported.profile).pad(), (30.0, 0.0), 0.5)


WINDOW = {"window_thickness_mm": 9.5}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"overrides": {"thickness_mm": 3.0}}, "gives the gel's shape"),
        ({"overrides": {"no_such": 3.0}}, "no_such"),
        ({"overrides": {"camera_distance_mm": 3}}, "camera_distance_mm = 3 is below its bound"),
        (
            {"overrides": {**WINDOW, "camera_distance_mm": 12.4}},
            "puts the camera inside the gel or the window",
        ),
        ({"overrides": {"marker_radius_mm": 0.6, "marker_pitch_mm": 1.0}}, "marker"),
        ({"parts": ("assembly",)}, "no part of an imported gel 'assembly'; known: pad"),
        ({"selection": FaceSelection(bond=("name:glue",))}, "matches none"),
    ],
)
def test_what_needs_no_mesh_is_refused_before_it(
    changes: dict[str, Any], words: str, step: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nobody = Mock(side_effect=AssertionError("nobody waits minutes for a mesh of this"))
    monkeypatch.setattr("taccel_lab.cad.mesh.tetrahedralize.tetwild_mesh", nobody)
    given = {"selection": SELECTION, "out_dir": tmp_path / "out", "parts": ()}
    with pytest.raises(InputError, match=words):
        import_design(step, **{**given, **changes})
    assert not (tmp_path / "out").exists()


def test_the_files_thickness(step: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file's gel is 3 mm thick, that of the family 4: the camera is outside of it."""
    meshed = Mock(side_effect=AssertionError("minutes"))
    monkeypatch.setattr("taccel_lab.cad.mesh.tetrahedralize.tetwild_mesh", meshed)
    overrides = {**WINDOW, "camera_distance_mm": 12.6}
    with pytest.raises(AssertionError, match="minutes"):
        import_design(step, SELECTION, tmp_path / "out", overrides=overrides)


def test_what_is_stated_is_not_assumed() -> None:
    stated = FaceSelection(normal="-x", unit="mm")
    assert set(stated.assumed()) == {"right", "origin"}
    assert stated.assumed()["right"].startswith("+y ")
    assert FaceSelection(normal="+z").assumed()["right"].startswith("+x ")
