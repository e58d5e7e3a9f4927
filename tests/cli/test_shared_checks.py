# SPDX-License-Identifier: Apache-2.0
"""The stages of ``calibrate all`` take the check of the captures that the first of them made."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import taccel_lab.calibration.check.block_findings as check
from taccel_lab.calibration.capture import CaptureFolder, load_capture_folder
from taccel_lab.calibration.check.block_findings import (
    capture_check,
    capture_findings,
    shared_checks,
)
from taccel_lab.calibration.check.run import CaptureCheck
from taccel_lab.cli import app
from taccel_lab.cli.calibrate.color import CalibrateColor
from taccel_lab.cli.calibrate.normals import CalibrateNormals
from taccel_lab.errors import InputError
from tests.cli.small_captures import write_captures


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Sources of the checks that are made."""
    sources: list[str] = []
    real = check.check_captures

    def counted(folder: CaptureFolder, **options: Any) -> CaptureCheck:
        sources.append(folder.source)
        return real(folder, **options)

    monkeypatch.setattr(check, "check_captures", counted)
    return sources


def test_one_check_serves_all_commands(tmp_path: Path, made: list[str]) -> None:
    folder = load_capture_folder(write_captures(tmp_path / "one"))
    other = load_capture_folder(write_captures(tmp_path / "two"))
    with shared_checks():
        first = capture_check(folder)
        assert capture_check(load_capture_folder(tmp_path / "one")) is first
        assert capture_check(folder, fit_ball=False) is first
        assert capture_findings(folder, "color") == [
            finding for finding in first.findings if "color" in finding.blocks
        ]
        assert len(made) == 1
        capture_check(other)
        assert len(made) == 2
    capture_check(folder)
    assert len(made) == 3


def test_a_check_without_the_ball_serves_nobody_else(tmp_path: Path, made: list[str]) -> None:
    folder = load_capture_folder(write_captures(tmp_path / "one"))
    with shared_checks():
        capture_check(folder, fit_ball=False)
        capture_check(folder)
    assert len(made) == 2


def test_a_changed_image_is_checked_again(tmp_path: Path, made: list[str]) -> None:
    path = write_captures(tmp_path / "one")
    with shared_checks():
        folder = load_capture_folder(path)
        capture_check(folder)
        press = Path(folder.presses[0].source)
        press.write_bytes(Path(folder.presses[1].source).read_bytes())
        capture_check(load_capture_folder(path))
    assert len(made) == 2


def test_stages_of_all_check_once(
    tmp_path: Path, made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def checks_and_refuses(self: CalibrateColor | CalibrateNormals) -> None:
        asked.append(type(self).__name__)
        capture_findings(load_capture_folder(self.captures), "color")
        raise InputError("no fit in this test")

    for command in (CalibrateColor, CalibrateNormals):
        monkeypatch.setattr(command, "run", checks_and_refuses)
    captures = write_captures(tmp_path / "one")
    arguments = ["calibrate", "all", str(captures), "--out", str(tmp_path / "unit")]
    with pytest.raises(SystemExit):
        app.main([*arguments, "--only", "background", "color", "normals"])
    assert asked == ["CalibrateColor", "CalibrateNormals"]
    assert len(made) == 1
