# SPDX-License-Identifier: Apache-2.0
"""``design_sensor`` and its command write everything or nothing."""

from __future__ import annotations

import dataclasses
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.profile import load_profile
from taccel_lab.sensors.design import DesignResult, design_sensor
from taccel_lab.sensors.families.gelsight import FAMILY
from taccel_lab.sensors.workshop import issue_of
from tests.geometry.vtu_files import read_mesh_vtu
from tests.support.commands import done, refusal


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> DesignResult:
    out = tmp_path_factory.mktemp("design") / "gelsight"
    return design_sensor(FAMILY, {"thickness_mm": 4.5}, out, edge_mm=1.5)


def written(result: DesignResult, file: str) -> dict[str, Any]:
    return json.loads(result.files[file].read_text())


@pytest.mark.thorough
def test_every_file_is_there_and_drawings_name_options_and_the_state(result: DesignResult) -> None:
    assert set(result.files) == {
        "mesh", "quality", "parameters", "preview", "profile",
        "step", "stl", "3mf", "dxf",
        "assembly", "assembly_report", "window_step", "window_stl", "housing_step", "housing_stl",
        "cover_step", "cover_stl",
        "mould_cavity", "mould_lid", "mould_3mf", "mould_report",
        "drawing", "drawing_pdf", "assembly_drawing",
    }  # fmt: skip
    assert all(path.exists() for path in result.files.values())
    assert result.files["preview"].read_bytes().startswith(b"\x89PNG")
    assert [p.name for p in result.out_dir.parent.iterdir()] == ["gelsight"]
    root = ET.parse(result.files["drawing"]).getroot()
    words = ["".join(n.itertext()).strip() for n in root.iter("{http://www.w3.org/2000/svg}text")]
    named = {word for word in words[words.index("unit") + 1 :] if word.endswith("_mm")}
    assert {"thickness_mm", "rim_mm"} <= named
    assert named <= set(FAMILY.parameters_type.parameters()), "what --set does not take"
    assert written(result, "parameters")["revision"] in words
    assert any(re.fullmatch(r"20\d\d-\d\d-\d\d", word) for word in words)


def test_revisions_follow_parameters_and_dates_the_build(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    first, same, other = (issue_of({"thickness_mm": t}) for t in (4.0, 4.0, 4.5))
    assert first == same and first.date == "1970-01-02"
    assert other.revision != first.revision


def test_files_hold_what_was_measured_and_set(result: DesignResult) -> None:
    quality = written(result, "quality")
    assert quality["min_dihedral_deg"] == result.quality.min_dihedral_deg > 10
    assert quality["node_count"] == result.mesh.node_count
    assert abs(quality["volume_error_percent"]) < 0.5
    assert quality["gate"]["passed"] and quality["gate"]["limits"]["min_dihedral_deg"] == 10
    assert quality["hausdorff_mm"] < 0.1
    assert quality["back_plane_error_mm"] < 1e-9
    assert set(quality["seconds"]) == {
        "cad", "mesh", "quality", "pad", "assembly", "mould", "drawing", "files",
    }  # fmt: skip
    assert all(value > 0 for value in quality["seconds"].values())
    assembly = written(result, "assembly_report")
    assert all(c["overlap_mm3"] < 1e-3 for c in assembly["clearances"] if not c["placeholder"])
    assert assembly["parts"]["window"]["position_mm"] == pytest.approx([0, 0, -4.5])
    assert assembly["parts"]["window"]["joints"] == ["bond", "seat"]
    mould = written(result, "mould_report")["mould"]
    grown = mould["gel_volume_mm3"] + mould["shrinkage_volume_mm3"] + mould["draft_volume_mm3"]
    assert mould["cavity_volume_mm3"] == pytest.approx(grown, rel=1e-5)
    assert mould["options"]["draft_deg"]["value"] == 2.0
    assert mould["gates"][0]["kind"] == "pour"
    parameters = written(result, "parameters")
    thickness = parameters["parameters"]["thickness_mm"]
    assert thickness["value"] == 4.5 and thickness["source"] == "set by the user"
    assert "gelmap" in parameters["parameters"]["crown_radius_mm"]["source"]
    assert parameters["part"]["bounding_box_min"][2] == pytest.approx(-4.5)
    # Mesh and profile come back.
    assert np.array_equal(read_mesh_vtu(result.files["mesh"]).nodes_m, result.mesh.nodes_m)
    profile = load_profile(result.files["profile"])
    assert np.array_equal(profile.mesh.tets, result.mesh.tets)
    assert profile.gel.thickness_mm == 4.5
    assert profile.material.poisson_ratio == result.parameters.material().poisson_ratio
    assert "assumption" in profile.material.provenance.source
    assert profile.grid() == FAMILY.parameters().grid()
    assert profile.sensor.parameters == result.parameters.values()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"overrides": {"thickness_mm": 1.6}}, "thickness_mm"),
        ({"mesher": "delaunay"}, "delaunay"),
        ({"edge_mm": 0.0}, "edge_mm"),
        ({"mesher": "tetwild", "edge_mm": 50.0}, "edge_mm"),
        ({"parts": ("engine",)}, r"no part of a design 'engine'; known: pad, assembly"),
        pytest.param(
            {"overrides": {"housing_x_mm": 24.2}, "parts": ("pad", "assembly")},
            r"housing_x_mm = 24\.2 .*leave the assembly out: --parts pad",
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_bad_input_leaves_no_files(options: dict[str, Any], words: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(InputError, match=words):
        design_sensor(FAMILY, out_dir=out, **options)
    assert not list(tmp_path.iterdir())
    out.mkdir()
    (out / "old").write_text("old")
    with pytest.raises(InputError, match="holds files that taccel-lab did not write"):
        design_sensor(FAMILY, out_dir=out)
    assert [p.name for p in tmp_path.rglob("*")] == ["out", "old"]


@pytest.mark.thorough
def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    words = ["--set", "rim=chamfer", "rim_mm=0.4", "--edge-mm", 2, "--parts", "pad"]
    found = done(capsys, "design", "gelsight", "--out", out, *words)
    assert found.code == 0
    assert "smallest dihedral angle" in found.out and "pad.step" in found.out
    assert json.loads((out / "parameters.json").read_text())["part"]["pad"]["rim"] == "chamfer"
    assert (out / "pad.step").exists() and not (out / "drawing.svg").exists()
    without = design_sensor(FAMILY, None, tmp_path / "without", edge_mm=1.5, parts=())
    assert set(without.files) == {"mesh", "quality", "parameters", "preview", "profile"}


def test_command_refuses_unknown_sensor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert "did you mean digit?" in refusal(capsys, "design", "digitt", "--out", out)
    assert "name=value" in refusal(capsys, "design", "gelsight", "--out", out, "--set", "thickness")
    assert not out.exists()


@pytest.mark.thorough
def test_a_bad_mesh_is_refused_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def squeezed(pad: Any, edge_mm: float) -> TetMesh:
        mesh = gel_mesh(pad, edge_mm)
        # Flat tets, all of positive volume.
        flat = mesh.nodes_m * [1, 1, 0.05] - [0, 0, 0.95e-3 * pad.thickness_mm]
        return dataclasses.replace(mesh, nodes_m=flat)

    monkeypatch.setattr("taccel_lab.sensors.design.gel_mesh", squeezed)
    with pytest.raises(InputError, match=r"angle under .*/out_refused/bad_mesh\.png .* tetwild"):
        design_sensor(FAMILY, None, tmp_path / "out", edge_mm=1.5, parts=())
    assert [path.name for path in tmp_path.iterdir()] == ["out_refused"]
    picture = tmp_path / "out_refused" / "bad_mesh.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
