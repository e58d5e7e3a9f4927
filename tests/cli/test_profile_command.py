# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab profile show``, ``validate``, ``compare`` and ``report``."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.profile import (
    CameraBlock,
    GelBlock,
    MaterialBlock,
    Provenance,
    SensorBlock,
    SensorProfile,
    load_profile,
    save_profile,
)
from tests.cli.conftest import Cli
from tests.support.small_captures import write_profile


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made_up = Provenance(kind="assumed", method="made up [bold]for[/] a test", source="none")
    tets = np.array([[0, 1, 2, 3]])
    mesh = TetMesh(
        np.array([[0, 0, -1], [1, 0, -1], [0, 1, -1], [0, 0, 0]]) * 1e-3,
        tets,
        boundary_faces(tets),
        np.array([0, 1, 2, 3]),
    )
    profile = SensorProfile(
        sensor=SensorBlock(name="unit 3", family="gelsight", provenance=made_up),
        gel=GelBlock(
            thickness_mm=1.0, node_count=4, tet_count=1, min_dihedral_deg=54.7, provenance=made_up
        ),
        material=MaterialBlock(
            young_modulus_pa=1.5e5,
            poisson_ratio=0.48,
            density_kg_m3=1070.0,
            friction_coefficient=0.6,
            provenance=made_up,
        ),
        camera=CameraBlock.from_grid(PixelGrid(12, 9, 0.03, 0.03), made_up),
        mesh=mesh,
    )
    save_profile(profile, tmp_path / "p")
    return tmp_path / "p"


def test_show(folder: Path, tmp_path: Path, cli: Cli) -> None:
    text = cli("profile show", folder, "--full").out
    for expected in ("unit 3", "young_modulus_pa", "150000.0", "[bold]for[/]"):
        assert expected in text
    text = cli("profile show", folder).out
    assert len(text.splitlines()) <= 24  # One screen.
    for word in ("material", "assumed", "1.5e+05", "--full"):
        assert word in text
    assert "none" in cli.refusal("profile show", tmp_path / "none")
    blocks = cli.json("profile show", folder)
    assert list(blocks) == ["sensor", "gel", "material", "camera"]
    assert blocks["material"]["poisson_ratio"] == 0.48
    assert blocks["camera"]["provenance"]["kind"] == "assumed"


def test_validate(folder: Path, cli: Cli) -> None:
    assert "is a sound profile" in cli("profile validate", folder).out
    (folder / "mesh.npz").write_bytes(b"PK")
    (folder / "notes.txt").write_text("mine")
    captured = cli("profile validate", folder, code=2)
    assert "mesh.npz: SHA-256" in captured.out and "warning" in captured.out
    assert "is not a sound profile: 1 error" in captured.err
    result = cli.json("profile validate", folder, code=2)
    assert result["valid"] is False
    assert [finding["severity"] for finding in result["findings"]] == ["error", "warning"]


@pytest.mark.parametrize(
    ("changes", "weights", "words"),
    [
        ({"foo": 3}, {}, "unknown \\['foo'\\]"),
        ({"hidden": [1_000_000_000]}, {}, "weights have shapes"),
        ({"hidden": "abc"}, {}, "wrong type"),
        ({}, {"extra": np.zeros(3, dtype=np.float32)}, "weights have shapes"),
        ({"output_scale": 1e5}, {}, "color model answers up to"),
        ({"width_px": 97}, {}, "97x72 px, the camera block says 96x72"),
    ],
)
def test_validate_builds_the_networks(
    changes: dict[str, object], weights: dict, words: str, tmp_path: Path, cli: Cli
) -> None:
    path = write_profile(tmp_path / "colored")
    cli("profile validate", path)
    profile = load_profile(path)
    assert profile.color is not None and profile.color_weights is not None
    block = profile.color.replace(architecture={**profile.color.architecture, **changes})
    save_profile(profile.with_block(block, {**profile.color_weights, **weights}), path)
    shown = cli("profile validate", path, code=2).out.replace("\n", " ")
    assert re.search(words, shown) and "color" in shown


def test_validate_and_press_judge_the_parameters(folder: Path, tmp_path: Path, cli: Cli) -> None:
    profile = load_profile(folder)
    parameters = {**profile.sensor.parameters, "thickness_mm": -5.0}
    path = tmp_path / "thin"
    save_profile(profile.with_block(profile.sensor.replace(parameters=parameters)), path)
    press = ["press", path, "--indenter", "sphere:4", "--depth-mm", "0.1", "--out", tmp_path / "o"]
    for command in (["profile validate", path], press):
        done = cli(*command, code=2)
        shown = (done.out + done.err).replace("\n", " ")
        assert "sensor.parameters.thickness_mm = -5 is below its bound" in shown


def test_compare_tells_what_differs(folder: Path, tmp_path: Path, cli: Cli) -> None:
    profile = load_profile(folder)
    softer = profile.with_block(profile.material.replace(young_modulus_pa=1.2e5))
    save_profile(softer, tmp_path / "q")
    shown = cli("profile compare", folder, tmp_path / "q").out
    assert "material.young_modulus_pa" in shown and "-3e+04" in shown
    arguments = [folder, tmp_path / "q", "--out", tmp_path / "page"]
    (field,) = cli.json("profile compare", *arguments)["fields"]
    assert field["difference"] == pytest.approx(-3e4) and field["z"] is None
    assert (tmp_path / "page" / "report.html").is_file()


def test_report_writes_a_page(folder: Path, tmp_path: Path, cli: Cli) -> None:
    cli("profile report", folder, "--out", tmp_path / "page")
    html = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    assert "Sensor profile unit 3" in html and "made up [bold]for[/] a test" in html


@pytest.mark.parametrize("command", [["compare"], ["report", "--out", "page"]])
def test_missing_profiles_and_foreign_folders_are_refused(
    command: list[str], folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    monkeypatch.chdir(tmp_path)
    others = [str(folder)] if command[0] == "compare" else []
    assert "no such profile folder" in cli.refusal("profile", *command, *others, "nowhere")
    (tmp_path / "page").mkdir()
    (tmp_path / "page" / "mine.txt").write_text("keep")
    out = [] if command[0] == "report" else ["--out", "page"]
    assert "did not write" in cli.refusal("profile", *command, *others, folder, *out)
    assert (tmp_path / "page" / "mine.txt").read_text() == "keep"
