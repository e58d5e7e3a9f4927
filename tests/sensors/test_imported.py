# SPDX-License-Identifier: Apache-2.0
"""A gel from a STEP file becomes the same files as a design, or is refused before anything."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from build123d import Plane, Solid, export_step

from taccel_lab.cad.step_import import FaceSelection
from taccel_lab.errors import InputError
from taccel_lab.sensors.imported import import_design
from tests.geometry.vtu_files import read_mesh_vtu

SELECTION = FaceSelection(contact=("plane:+z",), bond=("plane:-z",), window=("rect:5x4",))


@pytest.fixture
def step(tmp_path: Path) -> Path:
    path = tmp_path / "mine.step"
    export_step(Solid.make_box(8, 7, 3, Plane((2, 0, 0))), path)
    return path


def test_an_imported_block_is_meshed_and_all_files_are_written(
    step: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(tmp_path / "cache"))
    told: list[tuple[str, int, int]] = []
    result = import_design(
        step, SELECTION, tmp_path / "out", 1.5, progress=lambda *step: told.append(step)
    )
    assert set(result.files) == {
        "mesh", "quality", "gel", "preview", "step", "stl", "3mf", "dxf",
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


def test_what_is_stated_is_not_assumed() -> None:
    stated = FaceSelection(normal="-x", unit="mm")
    assert set(stated.assumed()) == {"right", "origin"}
    assert stated.assumed()["right"].startswith("+y ")
    assert FaceSelection(normal="+z").assumed()["right"].startswith("+x ")


def test_an_imported_gel_has_no_assembly(step: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="an imported gel has no assembly"):
        import_design(step, SELECTION, tmp_path / "out", parts=("assembly",))
    with pytest.raises(InputError, match="matches none"):
        import_design(step, FaceSelection(bond=("name:glue",)), tmp_path / "out")
    assert not (tmp_path / "out").exists()
