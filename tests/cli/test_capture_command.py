# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture`` and ``record``."""

from __future__ import annotations

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import importers, load, load_capture_folder
from taccel_lab.calibration.capture.importers.draft import Draft
from taccel_lab.calibration.record.folder import RecordFolder
from taccel_lab.files.videos import count_frames
from taccel_lab.profile import save_profile
from tests.calibration.record.sessions import source
from tests.cli.conftest import Cli
from tests.fuzz.samples.captures import write_video
from tests.support.small_captures import everything_below, write_captures, write_image
from tests.support.synthetic_presses import GRID, flat_profile


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_captures(tmp_path / "captures")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.thorough
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
        (["import", "plain", "out", "--sensor", "gelsite"], "gelsite"),
        (["import", "plain", "out", "--mm-per-px-y", "0.1"], "mm-per-px-x"),
        (["import", "plain", "out", "--background", "gone.png"], "no such background image"),
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

    monkeypatch.setattr(load, "count_frames", count)
    cli("capture import", "shear.avi", "out")
    assert out.is_dir() and counted and not any(counted)


@pytest.mark.thorough
def test_several_sets_are_checked_one_by_one(here: Path, cli: Cli) -> None:
    write_captures(here / "both" / "first")
    write_captures(here / "both" / "second")
    assert len(cli.json("capture check", "both")["parts"]) == 2


@pytest.mark.thorough
def test_the_report_of_several_sets_is_one_output(here: Path, cli: Cli) -> None:
    """It is replaced by the next one, and there as a whole or not at all."""
    for name in ("a[green]", "b"):
        write_captures(here / "both" / name)
    for _ in range(2):
        said = cli("capture check", "both", "--report", "page")
        assert (
            "both/a[green]/captures.toml (" in said.out and "wrote page/b/report.html" in said.err
        )
    pages = sorted(path.parent.name for path in (here / "page").rglob("report.html"))
    assert pages == ["a[green]", "b"]
    before = everything_below(here / "page")
    (here / "both" / "b" / "captures.toml").write_text("torn")
    cli("capture check", "both", "--report", "page", code=2)
    assert everything_below(here / "page") == before


@pytest.mark.thorough
def test_several_sets_of_a_layout_have_pages_of_their_own_names(here: Path, cli: Cli) -> None:
    """Not those of the passing folders that they are read from."""
    names = ["left", "right"]

    def parts(drafts: list[Draft]) -> list[Draft]:
        return [replace(draft, part=name) for name in names for draft in drafts]

    (here / "captures" / "captures.toml").unlink()
    read = importers.read_drafts
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            importers, "read_drafts", lambda *words: (read(*words)[0], parts(read(*words)[1]))
        )
        said = cli("capture check", "captures", "--report", "page", code=1)
    assert sorted(path.parent.name for path in (here / "page").rglob("report.html")) == names
    assert "taccel_lab_" not in said.out + said.err
    assert "taccel_lab_" not in (here / "page" / "left" / "report.html").read_text()


def test_guide_writes_a_manifest(here: Path, cli: Cli) -> None:
    out = cli("capture guide", "9dtact", "--out", "new.toml").out
    assert "minutes in all" in out and "Board of dots" in out
    assert 'sensor = "9dtact"' in (here / "new.toml").read_text()
    assert cli.json("capture guide", "digit_360")["minutes"] < 60


RECORD = ["capture record flat_pad --camera set --out out"]
FACTS = ["--radius-mm", "2", "--mm-per-px-x", "0.1", "--no-page"]


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    source(tmp_path / "set", 2)
    return tmp_path


@pytest.mark.thorough
def test_a_session_is_recorded_and_goes_on(bench: Path, cli: Cli) -> None:
    command = [*RECORD, *FACTS]
    printed = cli(*command, "--presses", "1", "--json")
    assert json.loads(printed.out)["presses"] == 1
    assert "Touch nothing" in printed.err and "Press next" in printed.err
    found = cli.json(*command, "--presses", "3")
    assert found["presses"] == 3 and found["contents"]["background"] == 1
    told = cli.refusal(*command, "--radius-mm", "2.5")
    assert "begun otherwise: --radius-mm was 2.0 and is 2.5" in told


@pytest.mark.thorough
def test_quick_says_what_it_leaves_out(bench: Path, cli: Cli) -> None:
    printed = cli("capture quick", "flat_pad", "--camera", "set", "--out", "out", *FACTS)
    assert "leaves out" in printed.err and "no load cell" in printed.err
    assert "2 of 20 presses" in printed.out and "same command continues it" in printed.out
    assert "# - force" in (bench / "out" / "captures.toml").read_text()


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
    bench: Path, cli: Cli, options: list[str], said: str
) -> None:
    assert said in cli.refusal(*RECORD, *options)
    assert not (bench / "out").exists()


@pytest.mark.thorough
def test_what_was_taken_is_told_whatever_ends_it(
    bench: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(RecordFolder, "add_press", full)
    said = cli.refusal(*RECORD, *FACTS)
    assert "out stays with 0 of" in said and "and the same command continues it" in said
    assert "No space left" in said


@pytest.mark.thorough
def test_lamps_are_printed_where_there_is_no_page(bench: Path, cli: Cli) -> None:
    folder = load_capture_folder(bench / "set")
    assert folder.background is not None
    dim = np.rint(0.8 * folder.presses[0].image()).astype(np.uint8)
    write_image(bench / "set" / "p00.png", dim)
    lines = cli(*RECORD, *FACTS).err.splitlines()
    assert sum(line.startswith("drift: ") for line in lines) == 1


def test_devices_are_listed(cli: Cli) -> None:
    assert isinstance(cli.json("capture devices")["cameras"], list)


def test_live_says_what_it_lacks(bench: Path, cli: Cli) -> None:
    save_profile(flat_profile(GRID), bench / "profile")
    command = ["live", "profile", "--camera", "set", "--no-page", "--no-paced"]
    assert "calibrate one first" in cli.refusal(*command)
    cli(*command, "--frames", "0", code=2)
    assert "has no background" in cli.refusal(*command, "--background", "profile")
    several = ["live", "left=profile", "--camera", "left=set,right=set", "--no-page"]
    assert "PROFILE has none for right; add right=PROFILE" in cli.refusal(*several)
    several[1] = "left=profile,thumb=profile"
    assert "PROFILE names thumb, --camera does not" in cli.refusal(*several)
    for camera, said in (("left=set,set", "left=A,right=B"), ("left=a,left=b", "may stand once")):
        several[3] = camera
        assert said in cli.refusal(*several)
