# SPDX-License-Identifier: Apache-2.0
"""What all exports share: the list of formats, records, missing blocks, whole folders."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

from taccel_lab.cli.profile import Export
from taccel_lab.errors import InputError
from taccel_lab.exporters import export as export_module
from taccel_lab.exporters import gs_sdk
from taccel_lab.exporters.export import EXPORTERS, RECORD_FILE, export_profile
from taccel_lab.exporters.frames import m_from_mm
from taccel_lab.exporters.record import ExportRecord
from taccel_lab.profile import SensorProfile
from tests.exporters.conftest import Exported

ROOT = Path(__file__).parents[2]


def test_every_format_is_in_the_help_and_in_the_docs() -> None:
    assert get_args(get_type_hints(Export)["to"]) == tuple(EXPORTERS)
    source = (ROOT / "taccel_lab" / "cli" / "profile.py").read_text()
    table = (ROOT / "docs" / "exporters.md").read_text()
    for name, exporter in EXPORTERS.items():
        assert f"    {name}: {exporter.what}" in source
        assert f"| `{name}` |" in table


@pytest.mark.parametrize(
    ("to", "lacking", "block", "command"),
    [
        ("tacto", "optics", "optics", "calibrate camera"),
        ("tacto", "lights", "lights", "taccel-lab design"),
        ("taxim", "color", "color", "calibrate color"),
        ("taxim", "background", "background", "calibrate background"),
        ("isaac-lab", "color", "color", "calibrate color"),
        ("gs-sdk", "color", "color", "calibrate color"),
        ("gs-sdk", "background", "background", "calibrate background"),
        ("onnx", "color", "color", "calibrate color"),
        ("safetensors", "color", "normals", "calibrate normals"),
        ("opencv", "optics", "optics", "calibrate camera"),
    ],
)
def test_missing_blocks_are_named_with_what_makes_them(
    to: str, lacking: str, block: str, command: str, mini: SensorProfile, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=rf"(?s)\b{block}\b") as caught:
        export_profile(mini.without(lacking), to, tmp_path / "out")
    assert command in str(caught.value) and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("to", ["taccel", "urdf"])
def test_geometry_needs_no_optional_block(to: str, mini: SensorProfile, tmp_path: Path) -> None:
    needed = ("sensor", "gel", "material", "camera")
    bare = mini.without(*(key for key in mini.blocks() if key not in needed))
    assert "gel" in export_profile(bare, to, tmp_path / "out")["carries"]


def test_the_record_lists_every_file(exported: Exported) -> None:
    out, document = exported("tacto")
    stored = json.loads((out / RECORD_FILE).read_text())
    assert stored == json.loads(json.dumps(document))
    paths = (path for path in out.rglob("[!.]*") if path.is_file())
    assert {*stored["files"], RECORD_FILE} == {str(path.relative_to(out)) for path in paths}
    assert stored["provenance"]["gel"]["kind"] == "designed"
    assert set(stored["carries"]).isdisjoint(stored["left_out"])


def test_an_export_replaces_its_own_but_not_others(mini: SensorProfile, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export_profile(mini, "opencv", out)
    export_profile(mini, "urdf", out)
    assert (out / "sensor.urdf").is_file() and not (out / "camera.yaml").exists()
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("long")
    with pytest.raises(InputError, match="did not write"):
        export_profile(mini, "urdf", mine)
    assert (mine / "thesis.txt").read_text() == "long"
    with pytest.raises(InputError, match="taccel, tacto, taxim"):
        export_profile(mini, "unity", out)


def test_a_failure_leaves_nothing(
    mini: SensorProfile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(profile: SensorProfile, folder: Path) -> ExportRecord:
        (folder / "half").write_text("written")
        raise OSError("disk full")

    monkeypatch.setitem(export_module.EXPORTERS, "urdf", replace(EXPORTERS["urdf"], write=broken))
    with pytest.raises(OSError, match="disk full"):
        export_profile(mini, "urdf", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.thorough(cases=("gs-sdk", "isaac-lab", "taxim"))
@pytest.mark.parametrize("to", ["taxim", "isaac-lab", "gs-sdk", "tacto"])
def test_dots_in_a_background_are_said_to_stand_still(
    to: str, mini: SensorProfile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert mini.markers is not None and mini.background_rgb is not None
    # Its network need not be good.
    quick = partial(gs_sdk.export_gs_sdk, steps=10, samples=2000)
    monkeypatch.setitem(EXPORTERS, "gs-sdk", replace(EXPORTERS["gs-sdk"], write=quick))
    found = export_profile(mini, to, tmp_path / "with")
    assert "stand still" in found["left_out"]["markers"]
    bare = export_profile(mini.without("markers"), to, tmp_path / "without")
    assert "stand still" not in bare["left_out"].get("markers", "")


@pytest.mark.parametrize("millimetres", [2.0, 0.1, 4.23, 17.0, 0.0295])
def test_millimetres_become_the_nearest_double(millimetres: float) -> None:
    assert m_from_mm(millimetres) == float(f"{millimetres}e-3")
    np.testing.assert_array_equal(m_from_mm(np.array([1.0, 2.0])), [0.001, 0.002])
