# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate color`` from a folder on disk to a profile, and its refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.base_profile import base_profile
from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.check.run import capture_check
from taccel_lab.cli.calibrate import block_commands
from taccel_lab.cli.profile import Export
from taccel_lab.errors import InputError
from taccel_lab.exporters.taxim_table import read_table
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.sensors.profile import catalogue_profile
from tests.support import synthetic_presses
from tests.support.capture_sets import edit_manifest


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Eight synthetic presses on disk, the last without a circle, and the base profile beside."""
    captures, _ = synthetic_presses.synthetic_captures(8)
    path = synthetic_presses.write_captures(tmp_path / "captures", captures, unlabelled=("p7",))
    save_profile(synthetic_presses.flat_profile(synthetic_presses.GRID, 3.0), tmp_path / "base")
    return path


def run(folder: Path, **changes: Any) -> Path:
    """A short fit over the base profile into a profile beside the captures."""
    out = folder.parent / "profile"
    values = {"base": folder.parent / "base", "steps": 5}
    block_commands()["color"](folder, out, **(values | changes)).run()
    return out


@pytest.mark.thorough
def test_the_fitted_table_lies_beside_the_report_and_is_exported(folder, monkeypatch) -> None:
    synthetic_presses.without_check(monkeypatch)
    save_profile(synthetic_presses.flat_profile(synthetic_presses.GRID), folder.parent / "flat")
    out = run(folder, base=folder.parent / "flat")
    path = folder.parent / "profile_report" / "polycalib.npz"
    file = read_table(path)
    assert file.image_size_px == (synthetic_presses.GRID.width_px, synthetic_presses.GRID.height_px)
    assert file.figures["heldout_presses"] == 2 and file.figures["heldout_disc_l1"] < 12
    Export(out, "taxim", folder.parent / "taxim", table=path).run()
    exported = read_table(folder.parent / "taxim" / "polycalib.npz").table
    assert np.array_equal(exported.grad_rgb, file.table.grad_rgb)


@pytest.mark.thorough
def test_bands_of_the_positional_encoding_are_asked_for(folder, capsys, monkeypatch) -> None:
    synthetic_presses.without_check(monkeypatch)
    block = load_profile(run(folder, position_bands=2, holdout_every=0, table=False)).color
    assert "No press was held out" in capsys.readouterr().out
    assert block is not None and block.architecture["position_bands"] == 2
    assert "2 bands of position" in block.provenance.method
    with pytest.raises(InputError, match=r"--position-bands of the color model .* 8\], got 9"):
        run(folder, position_bands=9)


@pytest.mark.thorough
def test_a_sensor_of_ones_own_is_a_flat_pad_and_the_report_says_so(folder, capsys) -> None:
    edit_manifest(folder, '"gelsight"', '"flat_pad"')
    profile = load_profile(run(folder, base=None, steps=20, table=False))
    assert profile.sensor.family == "flat_pad" and profile.grid() == synthetic_presses.GRID
    assert "flat_pad stands for a sensor" in " ".join(capsys.readouterr().err.split())
    report = json.loads((folder.parent / "profile_report" / "report.json").read_text())
    assert "flat_pad" in [remark["code"] for remark in report["remarks"]]
    assert profile.color is not None
    assert report["verdict"] == profile.color.provenance.verdict == "usable"


@pytest.mark.thorough
def test_what_is_missing_is_refused_with_the_other_faults(folder: Path) -> None:
    edit_manifest(folder, f"[indenter]\nradius_mm = {synthetic_presses.BALL_RADIUS_MM}", "")
    with pytest.raises(InputError, match=r"(?s)radius of the ball is missing.*more fault") as fault:
        run(folder)
    assert "presses" in str(fault.value) and not (folder.parent / "profile").exists()


def with_design(folder: Path, line: str) -> Path:
    return edit_manifest(folder, "[indenter]", f"[design]\n{line}\n[indenter]")


@pytest.mark.thorough
def test_a_measured_gel_is_what_the_presses_are_simulated_on(folder: Path) -> None:
    """Colours, normals and the check take it from the captures, not each from its own flag."""
    captures = load_capture_folder(with_design(folder, "thickness_mm = 3.5"))
    assert base_profile(None, captures).gel.thickness_mm == 3.5
    named = base_profile("gelsight", captures)
    assert named.gel.thickness_mm == 3.5 and named.camera.grid() == captures.grid()
    with pytest.raises(InputError, match="captures are of a gelsight, the profile digit is of"):
        base_profile(Path("digit"), captures)
    edit_manifest(folder, '"gelsight"', '"flat_pad"')
    for old, new, said in (("3.5", "4.0", False), ("thickness_mm = 4.0", "", True)):
        edited = load_capture_folder(edit_manifest(folder, old, new))
        assert ("flat_pad" in {found.code for found in capture_check(edited).findings}) == said


@pytest.mark.parametrize(
    ("line", "base", "said"),
    [
        ("thickness_mm = 3.5", True, r"= 3\.5 under \[design\], the profile .*designed has \d"),
        ("thickness = 3", False, r"no parameter 'thickness' \(did you mean thickness_mm"),
        ("thickness_mm = -3.0", False, r"thickness_mm = -3 is below its bound"),
        ('thickness_mm = "thick"', False, r"thickness_mm = 'thick' is not a number"),
    ],
)
def test_a_design_that_cannot_be_is_refused(folder: Path, line: str, base: bool, said: str) -> None:
    save_profile(catalogue_profile("gelsight"), folder.parent / "designed")
    said = said if base else rf"captures\.toml: .*{said}"
    with pytest.raises(InputError, match=said):
        run(with_design(folder, line), base=folder.parent / "designed" if base else None)
