# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate all``: what is written, printed, and the exit codes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from taccel_lab.calibration.blocks import BLOCKS
from taccel_lab.cli import app
from taccel_lab.cli.calibrate import calibrate_commands
from taccel_lab.cli.calibrate.blocks import BlockCommand
from taccel_lab.errors import InputError
from taccel_lab.profile import load_profile
from tests.support.small_captures import write_captures


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    return write_captures(tmp_path / "captures")


def run(*arguments: str) -> int:
    try:
        return app.main(["calibrate", "all", *arguments])
    except SystemExit as stop:
        return int(stop.code or 0)


def test_profile_and_reports_are_written(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "unit"
    blocks = ["--only", "background", "markers", "spread"]
    assert run(str(captures), "--out", str(out), *blocks, "--json") == 0
    shown = json.loads(capsys.readouterr().out)["blocks"]
    assert [(s["name"], s["state"]) for s in shown] == [
        ("background", "done"),
        ("markers", "skipped"),
        ("spread", "done"),
    ]
    assert load_profile(out).perturbation is not None
    report = tmp_path / "unit_report"
    assert (report / "background" / "report.html").is_file()
    assert (report / "report.html").is_file()
    assert not list(tmp_path.glob(".*"))


def test_every_block_has_a_command() -> None:
    commands = {
        name: command.page_reads_folder
        for name, command in calibrate_commands().items()
        if issubclass(command, BlockCommand)
    }
    assert commands == {block.name: block.reads_folder for block in BLOCKS}


def test_a_block_that_refuses_ends_with_1(
    captures: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def refuse(*_: object) -> None:
        raise InputError("the light is off")

    blocks = tuple(replace(b, verb=refuse) if b.name == "background" else b for b in BLOCKS)
    monkeypatch.setattr("taccel_lab.calibration.calibrate.BLOCKS", blocks)
    out = tmp_path / "unit"
    assert run(str(captures), "--out", str(out), "--only", "background", "spread") == 1
    assert "the light is off" in "".join(capsys.readouterr())
    assert load_profile(out).perturbation is not None


def test_nothing_to_do_writes_nothing(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(str(captures), "--out", str(tmp_path / "unit"), "--only", "markers") == 2
    assert "nothing could be calibrated" in capsys.readouterr().err
    assert not (tmp_path / "unit").exists() and not (tmp_path / "unit_report").exists()
