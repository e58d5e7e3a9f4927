# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture record``, ``quick``, ``devices`` and ``live``: codes, messages, JSON."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from taccel_lab.cli.app import main
from taccel_lab.profile import save_profile
from tests.calibration.record.sessions import source
from tests.calibration.synthetic import GRID, flat_profile

FACTS = ["--radius-mm", "2", "--mm-per-px-x", "0.1", "--no-page"]


def run(arguments: list[str]) -> int:
    try:
        return main(arguments)
    except SystemExit as left:
        return int(left.code or 0)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    source(tmp_path / "set", 2)
    return tmp_path


def test_a_session_is_recorded_and_goes_on(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["capture", "record", "flat_pad", "--camera", "set", "--out", "out", *FACTS, "--json"]
    assert run([*command, "--presses", "1"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["presses"] == 1
    assert "Touch nothing" in printed.err and "Press next" in printed.err
    assert run([*command, "--presses", "3"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["presses"] == 3 and found["contents"]["background"] == 1
    assert run([*command, "--radius-mm", "2.5"]) == 2
    assert "begun otherwise: --radius-mm was 2.0 and is 2.5" in capsys.readouterr().err


def test_quick_says_what_it_leaves_out(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["capture", "quick", "flat_pad", "--camera", "set", "--out", "out", *FACTS]) == 0
    printed = capsys.readouterr()
    assert "leaves out" in printed.err and "no load cell" in printed.err
    assert "2 of 20 presses" in printed.out and "same command goes on" in printed.out
    assert "# - force" in (here / "out" / "captures.toml").read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "--radius-mm"),
        ([*FACTS, "--camera", "nowhere"], "nowhere"),
        ([*FACTS, "--crop", "all"], "--crop is 'all'"),
        ([*FACTS, "--scale", "later"], "give one"),
        (["--radius-mm", "0.001"], "--radius-mm is 0.001"),
        ([*FACTS, "--presses", "0"], "--presses is 0"),
        ([*FACTS, "--mm-per-px-x", "50"], "mm/px is allowed"),
    ],
)
def test_bad_input_is_told_and_leaves_nothing(
    here: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    command = ["capture", "record", "flat_pad", "--camera", "set", "--out", "out"]
    assert run([*command, *options]) == 2
    assert said in capsys.readouterr().err
    assert not (here / "out").exists()


def test_devices_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["capture", "devices", "--json"]) == 0
    assert isinstance(json.loads(capsys.readouterr().out)["cameras"], list)


def test_live_says_what_it_lacks(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_profile(flat_profile(GRID), here / "profile")
    command = ["live", "profile", "--camera", "set", "--no-page", "--no-paced"]
    assert run(command) == 2
    assert "calibrate one first" in capsys.readouterr().err
    assert run([*command, "--frames", "0"]) == 2
    assert run([*command, "--background", "profile"]) == 2
    assert "has no background" in capsys.readouterr().err
