# SPDX-License-Identifier: Apache-2.0
"""A gel from a STEP file becomes the same files as a design, or is refused before anything."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from build123d import Plane, Solid, export_step

from taccel_lab.cad.gel_import import FaceSelection
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.presses import (
    PHYSICS,
    Accuracy,
    PressPath,
    parse_indenter,
    profile_material,
    simulate_press,
)
from taccel_lab.profile import load_profile
from taccel_lab.sensors.imported import ImportResult, import_design
from taccel_lab.sensors.press_mesh import pad_press_mesh, profile_press_mesh
from taccel_lab.sensors.registry import sensor_family
from tests.geometry.vtu_files import read_mesh_vtu

SELECTION = FaceSelection(contact=("plane:+z",), bond=("plane:-z",), window=("rect:5x4",))


@pytest.fixture
def step(tmp_path: Path) -> Path:
    path = tmp_path / "mine.step"
    export_step(Solid.make_box(8, 7, 3, Plane((2, 0, 0))), path)
    return path


@pytest.mark.thorough
def test_an_imported_block_is_meshed_and_all_files_are_written(
    step: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(tmp_path / "cache"))
    told: list[tuple[str, int, int]] = []
    result = import_design(
        step, SELECTION, tmp_path / "out", 1.5, progress=lambda *step: told.append(step)
    )
    assert set(result.files) == {
        "mesh", "quality", "gel", "faces", "preview", "profile", "step", "stl", "3mf", "dxf",
        "mould_cavity", "mould_lid", "mould_3mf", "mould_report", "drawing", "drawing_pdf",
    }  # fmt: skip
    for path in result.files.values():
        assert path.exists(), path
    assert told[:3] == [("import", 0, 1), ("import", 1, 1), ("mesh", 0, 1)]
    written = json.loads(result.files["gel"].read_text())
    assert written["file"] == "mine.step" and written["thickness_mm"] == pytest.approx(3.0)
    assert written["selection"]["window"] == ["rect:5x4"]
    assert set(written["assumed"]) == {"normal", "right", "origin", "unit"}
    assert written["assumed"]["right"] == "+x of the file becomes the gel's x"
    assert np.array(written["gel_from_file"]["rotation_and_scale"]) == pytest.approx(np.eye(3))
    assert written["gel_from_file"]["shift_mm"] == pytest.approx([-6, -3.5, -3], abs=1e-6)
    mesh = read_mesh_vtu(result.files["mesh"])
    assert mesh.volumes_m3().sum() * 1e9 == pytest.approx(8 * 7 * 3, rel=5e-3)
    areas = result.quality.region_areas_mm2
    assert areas["window"] == pytest.approx(20, rel=0.2)
    assert areas["window"] + areas["bond"] == pytest.approx(56, rel=0.02)
    assert areas["contact"] == pytest.approx(56, rel=0.02)
    assert result.quality.min_dihedral_deg >= 10
    assert result.quality.back_plane_error_mm < 1e-6


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
    assert "like gelsight_mini with young_modulus_mpa = 0.2" in profile.sensor.provenance.source
    assert list(profile.sensor.provenance.inputs) == ["my gel.step"]


@pytest.mark.thorough
def test_a_press_on_an_imported_gel_is_that_on_the_same_pad(imported: ImportResult) -> None:
    """The catalogue's flat pad of the same size, edges sharp: a ball of 2 mm, 0.4 mm deep."""
    values = {"length_x_mm": 14, "length_y_mm": 12, "thickness_mm": 4, "corner_radius_mm": 0.3}
    parameters = sensor_family("flat_pad").parameters({**values, "width_px": 160, "height_px": 120})
    physics, ball = PHYSICS[Accuracy.DEFAULT], parse_indenter("sphere:2")
    material = profile_material(imported.profile.material, imported.mesh)
    forces = []
    for mesh in (
        profile_press_mesh(imported.profile, (1.0, -0.5), ball.contact(0.4)),
        pad_press_mesh(parameters.pad(), (1.0, -0.5), ball.contact(0.4)),
    ):
        outcome = simulate_press(
            mesh, material, ball, (1.0, -0.5), PressPath(0.4), imported.profile.grid(),
            friction_coefficient=0.5, physics=physics,
        )  # fmt: skip
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
    contact = parse_indenter(tool).contact(0.3)
    mesh = profile_press_mesh(imported.profile, (0.0, 0.0), contact)
    # An edge's 6 mm asked for 33,000 to 39,400 in ten runs.
    assert imported.mesh.tet_count < mesh.tet_count < most
    size_mm = 1.8 * radius_mm * 0.3
    from_middle_mm = np.linalg.norm(middles_mm(mesh), axis=1)
    at_tool = from_middle_mm < 0.75 * size_mm  # One holds the middle, and its own is so close.
    asked_mm = size_mm + np.maximum(from_middle_mm - 0.3 * radius_mm, 0.0)
    assert at_tool.any()
    assert (longest_edges_mm(mesh) <= asked_mm)[at_tool].all()
    assert spacing_beside_mm(mesh) > 0.85 * spacing_beside_mm(imported.mesh)


def middles_mm(mesh: TetMesh) -> np.ndarray:
    return 1e3 * mesh.nodes_m[mesh.tets].mean(axis=1)


def longest_edges_mm(mesh: TetMesh) -> np.ndarray:
    corners = 1e3 * mesh.nodes_m[mesh.tets]
    return np.linalg.norm(corners[:, :, None] - corners[:, None], axis=-1).max(axis=(1, 2))


def spacing_beside_mm(mesh: TetMesh) -> float:
    """Edge of regular tets as large as those more than 5 mm beside tools along y."""
    beside = np.abs(middles_mm(mesh)[:, 0]) > 5.0
    return 1e3 * float(np.median(np.cbrt(6 * np.sqrt(2) * mesh.volumes_m3()[beside])))


def test_presses_beside_an_imported_gel_are_refused(imported: ImportResult) -> None:
    with pytest.raises(InputError, match=r"ends .* mm away from"):
        profile_press_mesh(imported.profile, (30.0, 0.0), 0.5)


def test_what_the_file_says_cannot_be_set(step: Path, tmp_path: Path) -> None:
    for name, words in (("thickness_mm", "gives the gel's shape"), ("no_such", "no_such")):
        with pytest.raises(InputError, match=words):
            import_design(step, SELECTION, tmp_path / "out", overrides={name: 3.0}, parts=())
        assert not (tmp_path / "out").exists()


def test_what_needs_no_mesh_is_refused_before_it(
    step: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def mesh(*_: object, **__: object) -> None:
        raise AssertionError("nobody waits minutes for a mesh of this")

    monkeypatch.setattr("taccel_lab.cad.mesh.tetrahedralize.tetwild_mesh", mesh)
    # The file's gel is 3 mm thick and counts, that of the family 4.
    window = {"window_thickness_mm": 9.5}
    with pytest.raises(AssertionError, match="minutes"):
        import_design(
            step, SELECTION, tmp_path / "out", overrides={**window, "camera_distance_mm": 12.6}
        )
    for overrides, words in (
        ({"camera_distance_mm": 3}, "camera_distance_mm = 3 is below its bound"),
        ({**window, "camera_distance_mm": 12.4}, "puts the camera inside the gel or the window"),
        ({"marker_radius_mm": 0.6, "marker_pitch_mm": 1.0}, "marker"),
    ):
        with pytest.raises(InputError, match=words):
            import_design(step, SELECTION, tmp_path / "out", overrides=overrides, parts=())
    assert not (tmp_path / "out").exists()


def test_what_is_stated_is_not_assumed() -> None:
    stated = FaceSelection(normal="-x", unit="mm")
    assert set(stated.assumed()) == {"right", "origin"}
    assert stated.assumed()["right"].startswith("+y ")
    assert FaceSelection(normal="+z").assumed()["right"].startswith("+x ")


def test_an_imported_gel_has_no_assembly(step: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no part of an imported gel 'assembly'; known: pad"):
        import_design(step, SELECTION, tmp_path / "out", parts=("assembly",))
    with pytest.raises(InputError, match="matches none"):
        import_design(step, FaceSelection(bond=("name:glue",)), tmp_path / "out")
    assert not (tmp_path / "out").exists()
