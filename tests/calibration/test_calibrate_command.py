# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate color`` from a folder on disk to a profile, and its refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.base_profile import base_profile
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.check.run import capture_check
from taccel_lab.cli.calibrate import CalibrateColor
from taccel_lab.cli.profile import Export
from taccel_lab.errors import InputError
from taccel_lab.exporters.taxim_table import read_table
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.synthetic_presses import (
    BALL_RADIUS_MM,
    GRID,
    flat_profile,
    synthetic_captures,
    without_check,
    write_captures,
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Eight synthetic presses on disk, the last without a circle, and the base profile beside."""
    captures, _ = synthetic_captures(8)
    path = write_captures(tmp_path / "captures", captures, unlabelled=("p7",))
    save_profile(flat_profile(GRID, 3.0), tmp_path / "base")
    return path


def command(folder: Path, **changes: Any) -> CalibrateColor:
    """A short fit over the base profile into ``profile`` beside the captures."""
    values = {"base": folder.parent / "base", "steps": 5}
    return CalibrateColor(folder, folder.parent / "profile", **(values | changes))


@pytest.mark.thorough
def test_the_fitted_table_lies_beside_the_report_and_is_exported(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_check(monkeypatch)
    out, base = folder.parent / "profile", folder.parent / "flat"
    save_profile(flat_profile(GRID), base)
    command(folder, base=base).run()
    path = folder.parent / "profile_report" / "polycalib.npz"
    file = read_table(path)
    assert file.image_size_px == (GRID.width_px, GRID.height_px)
    assert file.figures["heldout_presses"] == 2 and file.figures["heldout_disc_l1"] < 12
    Export(out, "taxim", folder.parent / "taxim", table=path).run()
    exported = read_table(folder.parent / "taxim" / "polycalib.npz").table
    assert np.array_equal(exported.grad_rgb, file.table.grad_rgb)


@pytest.mark.thorough
def test_bands_of_the_positional_encoding_are_asked_for(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    without_check(monkeypatch)
    command(folder, position_bands=2, holdout_every=0, table=False).run()
    assert "No press was held out" in capsys.readouterr().out
    profile = load_profile(folder.parent / "profile")
    assert profile.color is not None and profile.color.architecture["position_bands"] == 2
    assert "2 bands of position" in profile.color.provenance.method
    with pytest.raises(InputError, match=r"position_bands must lie in \[0, 8\], got 9"):
        command(folder, position_bands=9).run()


@pytest.mark.thorough
def test_a_sensor_of_ones_own_is_a_flat_pad_and_the_report_says_so(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = folder / "captures.toml"
    manifest.write_text(manifest.read_text().replace('"gelsight"', '"flat_pad"'))
    command(folder, base=None, steps=20, table=False).run()
    profile = load_profile(folder.parent / "profile")
    assert profile.sensor.family == "flat_pad" and profile.grid() == GRID
    assert "flat_pad stands for a sensor" in " ".join(capsys.readouterr().err.split())
    report = json.loads((folder.parent / "profile_report" / "report.json").read_text())
    assert "flat_pad" in [remark["code"] for remark in report["remarks"]]
    assert report["verdict"] == "usable"
    assert profile.color is not None and profile.color.provenance.verdict == "usable"


@pytest.mark.thorough
def test_what_is_missing_is_refused_with_the_other_faults(folder: Path) -> None:
    manifest = folder / "captures.toml"
    text = (
        manifest.read_text().replace("[indenter]", "").replace(f"radius_mm = {BALL_RADIUS_MM}", "")
    )
    manifest.write_text(text)
    out = folder.parent / "profile"
    with pytest.raises(
        InputError, match=r"radius of the ball is missing(.|\n)*more faults"
    ) as found:
        CalibrateColor(folder, out, base=folder.parent / "base").run()
    assert "presses" in str(found.value) and not out.exists()


def with_design(folder: Path, lines: str) -> Path:
    manifest = folder / "captures.toml"
    text = manifest.read_text()
    manifest.write_text(text.replace("[indenter]", f"[design]\n{lines}\n[indenter]"))
    return folder


@pytest.mark.thorough
def test_a_measured_gel_is_what_the_presses_are_simulated_on(folder: Path) -> None:
    """Colours, normals and the check take it from the captures, not each from a flag of its own."""
    captures = load_capture_folder(with_design(folder, "thickness_mm = 3.5"))
    assert base_profile(None, captures).gel.thickness_mm == 3.5
    manifest = folder / "captures.toml"
    for line, said in (("", True), ("thickness_mm = 4.0", False)):
        text = manifest.read_text().replace('"gelsight"', '"flat_pad"')
        manifest.write_text(text.replace("thickness_mm = 3.5", line))
        found = capture_check(load_capture_folder(folder)).findings
        assert ("flat_pad" in [finding.code for finding in found]) == said
        manifest.write_text(text)


@pytest.mark.thorough
def test_the_base_may_be_a_sensor_of_the_catalogue(folder: Path) -> None:
    captures = load_capture_folder(with_design(folder, "thickness_mm = 3.5"))
    named = base_profile("gelsight", captures)
    assert named.gel.thickness_mm == 3.5 and named.camera.grid() == captures.grid()
    with pytest.raises(InputError, match="captures are of a gelsight, the profile digit is of"):
        base_profile(Path("digit"), captures)


def test_a_profile_of_another_gel_than_the_captures_state_is_refused(folder: Path) -> None:
    with_design(folder, "thickness_mm = 3.5")
    base = folder.parent / "designed"
    save_profile(catalogue_profile("gelsight"), base)
    said = r"states thickness_mm = 3\.5 under \[design\], the profile .*designed has \d"
    with pytest.raises(InputError, match=said):
        CalibrateColor(folder, folder.parent / "profile", base=base).run()


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            "thickness = 3",
            r"captures\.toml: .*no parameter 'thickness' \(did you mean thickness_mm",
        ),
        ("thickness_mm = -3.0", r"captures\.toml: .*thickness_mm = -3 is below its bound"),
        ('thickness_mm = "thick"', r"captures\.toml: .*thickness_mm = 'thick' is not a number"),
    ],
)
def test_a_design_that_cannot_be_is_refused(folder: Path, lines: str, said: str) -> None:
    with_design(folder, lines)
    with pytest.raises(InputError, match=said):
        CalibrateColor(folder, folder.parent / "profile").run()
