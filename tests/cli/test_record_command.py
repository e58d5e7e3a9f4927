# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture record``, ``quick``, ``devices`` and ``live``: codes, messages, JSON."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.record.folder import RecordFolder
from taccel_lab.profile import save_profile
from tests.calibration.record.sessions import source
from tests.cli.conftest import Cli
from tests.support.capture_sets import write_image
from tests.support.synthetic_presses import GRID, flat_profile

RECORD = ["capture record flat_pad --camera set --out out"]
FACTS = ["--radius-mm", "2", "--mm-per-px-x", "0.1", "--no-page"]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    source(tmp_path / "set", 2)
    return tmp_path


def test_a_session_is_recorded_and_goes_on(here: Path, cli: Cli) -> None:
    command = [*RECORD, *FACTS]
    printed = cli(*command, "--presses", "1", "--json")
    assert json.loads(printed.out)["presses"] == 1
    assert "Touch nothing" in printed.err and "Press next" in printed.err
    found = cli.json(*command, "--presses", "3")
    assert found["presses"] == 3 and found["contents"]["background"] == 1
    told = cli.refusal(*command, "--radius-mm", "2.5")
    assert "begun otherwise: --radius-mm was 2.0 and is 2.5" in told


def test_quick_says_what_it_leaves_out(here: Path, cli: Cli) -> None:
    printed = cli("capture quick", "flat_pad", "--camera", "set", "--out", "out", *FACTS)
    assert "leaves out" in printed.err and "no load cell" in printed.err
    assert "2 of 20 presses" in printed.out and "same command continues it" in printed.out
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
    here: Path, cli: Cli, options: list[str], said: str
) -> None:
    assert said in cli.refusal(*RECORD, *options)
    assert not (here / "out").exists()


def test_what_was_taken_is_told_whatever_ends_it(
    here: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(RecordFolder, "add_press", full)
    said = cli.refusal(*RECORD, *FACTS)
    assert "stopped at 0 of" in said and "out is whole, and the same command continues it" in said
    assert "No space left" in said


def test_lamps_are_printed_where_there_is_no_page(here: Path, cli: Cli) -> None:
    folder = load_capture_folder(here / "set")
    assert folder.background is not None
    dim = np.rint(0.8 * folder.presses[0].image()).astype(np.uint8)
    write_image(here / "set" / "p00.png", dim)
    lines = cli(*RECORD, *FACTS).err.splitlines()
    assert sum(line.startswith("drift: ") for line in lines) == 1


def test_devices_are_listed(cli: Cli) -> None:
    assert isinstance(cli.json("capture devices")["cameras"], list)


def test_live_says_what_it_lacks(here: Path, cli: Cli) -> None:
    save_profile(flat_profile(GRID), here / "profile")
    command = ["live", "profile", "--camera", "set", "--no-page", "--no-paced"]
    assert "calibrate one first" in cli.refusal(*command)
    cli(*command, "--frames", "0", code=2)
    assert "has no background" in cli.refusal(*command, "--background", "profile")
