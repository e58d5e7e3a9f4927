# SPDX-License-Identifier: Apache-2.0
"""The template of docs/sensors.md works as a package beside this one."""

from __future__ import annotations

import importlib
import json
import sys
import tomllib
from pathlib import Path

import pytest

from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.mesh.quality import measure_quality, require_quality
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.sensors import sensor_family
from taccel_lab.sensors.registry import catalogue
from tests.support.commands import done, refusal

TEMPLATE = Path(__file__).parents[2] / "docs" / "examples" / "my_sensor"


@pytest.fixture
def template(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The template as an editable installation leaves it: on sys.path, with its metadata."""
    project = tomllib.loads((TEMPLATE / "pyproject.toml").read_text())["project"]
    info = tmp_path / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    lines = []
    for group, entries in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {target}" for name, target in entries.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    monkeypatch.syspath_prepend(str(TEMPLATE))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_sensor", raising=False)
    importlib.invalidate_caches()


@pytest.mark.thorough
@pytest.mark.usefixtures("template")
def test_template_is_listed_and_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert not catalogue().broken
    assert "my_sensor" in done(capsys, "sensors", "list").out
    picture = tmp_path / "my_sensor.png"
    printed = done(capsys, "sensors", "show", "my_sensor", "--picture", picture).out
    assert "edge_mm" in printed and "our drawing 1207" in printed
    assert picture.read_bytes().startswith(b"\x89PNG")
    words = ["sensors", "show", "my_sensor", "--set", "edge_mm=1", "--json"]
    shown = json.loads(done(capsys, *words).out)
    assert shown["pad"]["values"]["rim_mm"] == 1.0
    assert shown["markers"]["columns"] == 11 and shown["markers"]["rows"] == 8
    assert len(shown["optics"]["lights"]) == 4


@pytest.mark.thorough
@pytest.mark.usefixtures("template")
def test_template_is_built_and_meshed() -> None:
    family = sensor_family("my_sensor")
    pad = family.parameters({"thickness_mm": 5.0, "edge_mm": 1.2}).pad()
    mesh = gel_mesh(pad)
    quality = measure_quality(mesh, pad)
    require_quality(mesh, quality)
    built = labelled_solid(pad).solid.volume
    assert mesh.volumes_m3().sum() * 1e9 == pytest.approx(built, rel=5e-3)


@pytest.mark.usefixtures("template")
def test_bad_values_name_the_bound(capsys: pytest.CaptureFixture[str]) -> None:
    words = refusal(capsys, "sensors", "show", "my_sensor", "--set", "edge_mm=2.5")
    assert "edge_mm = 2.5 is above its bound; allowed: 0.2 to 1.8 mm" in words
