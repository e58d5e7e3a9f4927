# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture``: exit codes, messages, JSON, reports, and nothing left behind."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import video
from taccel_lab.files.videos import count_frames
from tests.cli.conftest import Cli
from tests.fuzz.samples.captures import write_video
from tests.support.small_captures import everything_below, write_captures, write_image


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_captures(tmp_path / "captures")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_check_writes_a_page(here: Path, cli: Cli) -> None:
    figures = cli.json("capture check", "captures", "--report", "page")
    assert figures["usable"] and len(figures["presses"]) == 5
    states = {block["command"].split()[-1]: block["readiness"] for block in figures["blocks"]}
    assert states["color"] == "weak"  # five presses
    page = (here / "page" / "report.html").read_text(encoding="utf-8")
    assert "Blocks of a profile" in page and "data:image/png" in page
    report = json.loads((here / "page" / "report.json").read_text())
    assert report["verdict"] == "usable"
    pictures = {path.stem for path in (here / "page").glob("*.png")}
    assert pictures == {"coverage", "frames", "light"}


def test_check_fails_when_something_blocks(here: Path, cli: Cli) -> None:
    manifest = here / "captures" / "captures.toml"
    manifest.write_text(manifest.read_text().replace("[indenter]\nradius_mm = 2.0\n", ""))
    out = cli("capture check", "captures", code=1).out.replace("\n", " ")
    assert "error: the radius of the ball is not stated" in out
    assert "blocked" in out and "[red]" not in out


def test_check_reads_a_plain_folder(here: Path, cli: Cli) -> None:
    (here / "captures" / "captures.toml").unlink()
    before = everything_below(here)
    figures = cli.json("capture check", "captures", code=1)
    assert figures["contents"]["ball_presses"] == 5 and figures["contents"]["background"] == 1
    assert any("read as plain" in note for note in figures["notes"])
    assert everything_below(here) == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["check", "gone"], "gone does not exist"),
        (["check", "empty"], "follows none of the layouts known"),
        (["check", "captures", "--report", "captures"], "files that taccel-lab did not write"),
        (["import", "gone", "out"], "gone does not exist"),
        (["import", "captures", "out"], "is a capture folder already"),
        (["import", "plain", "out", "--layout", "taxi"], "no layout 'taxi'; known: auto, taxim"),
        (["import", "plain", "out", "--sensor", "gelsite"], "gelsite"),
        (["import", "plain", "out", "--radius-mm", "-1"], "--radius-mm is -1; 0.05 to 50 mm"),
        (["import", "plain", "out", "--radius-mm", "1e9"], "--radius-mm is 1e+09; 0.05 to 50 mm"),
        (["import", "plain", "out", "--mm-per-px-y", "0.1"], "mm-per-px-x"),
        (["import", "plain", "out", "--background", "gone.png"], "no such background image"),
        (["import", "plain", "out", "--board", "6x6"], "chessboard:6x6:2.5"),
        (["import", "plain", "captures"], "files that taccel-lab did not write"),
        (["guide", "gelsite"], "known: 9dtact, digit"),
        (["guide", "digit", "--out", "captures/captures.toml"], "exists; name a file"),
        (["guide", "digit", "--out", "captures/captures.toml/x"], "part of this path is a file"),
    ],
)
def test_refusals_change_nothing(here: Path, cli: Cli, arguments: list[str], words: str) -> None:
    (here / "empty").mkdir()
    (here / "plain").mkdir()
    for name in ("bg", "a", "b"):
        write_image(here / "plain" / f"{name}.png", np.full((48, 64, 3), 90, np.uint8))
    before = everything_below(here)
    assert words in cli.refusal("capture", *arguments)
    assert everything_below(here) == before


def test_import_then_check(here: Path, cli: Cli) -> None:
    (here / "captures" / "captures.toml").unlink()
    facts = ["--sensor", "gelsight", "--radius-mm", "2", "--mm-per-px-x", "0.1"]
    printed = cli.json("capture import captures out", *facts)
    assert printed["layout"] == "plain"
    assert printed["folders"][0]["contents"]["ball_presses"] == 5
    cli("capture check", "out", "--json")


def test_nothing_is_read_of_an_import_that_stands(
    here: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    """A video whose end is searched for minutes would be refused after it was written."""
    write_video(here / "shear.avi")
    counted, out = [], here / "out"

    def count(path: Path) -> tuple[int, int]:
        counted.append(out.exists())
        return count_frames(path)

    monkeypatch.setattr(video, "count_frames", count)
    cli("capture import", "shear.avi", "out")
    assert out.is_dir() and counted and not any(counted)


def test_several_sets_are_checked_one_by_one(here: Path, cli: Cli) -> None:
    write_captures(here / "both" / "first")
    write_captures(here / "both" / "second")
    assert len(cli.json("capture check", "both")["parts"]) == 2


def test_guide_writes_a_manifest(here: Path, cli: Cli) -> None:
    out = cli("capture guide", "9dtact", "--out", "new.toml").out
    assert "minutes in all" in out and "Board of dots" in out
    assert 'sensor = "9dtact"' in (here / "new.toml").read_text()
    assert cli.json("capture guide", "digit_360")["minutes"] < 60
