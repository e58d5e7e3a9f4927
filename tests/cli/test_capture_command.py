# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture`` and its sessions; ``test_refusals.py`` has what it refuses."""

from __future__ import annotations

import errno
import json
import os
import re
import threading
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from taccel_lab.calibration.capture import importers, load, load_capture_folder
from taccel_lab.calibration.capture.importers.draft import Draft
from taccel_lab.calibration.record.folder import RecordFolder
from taccel_lab.calibration.record.labelling import Labelling
from taccel_lab.files.videos import count_frames
from tests.calibration.capture.made_up_layouts import source_of
from tests.calibration.record.sessions import source
from tests.cli.conftest import Cli
from tests.fuzz.samples.captures import write_video
from tests.support.small_captures import everything_below, write_captures, write_image


@pytest.mark.thorough
def test_check_writes_a_page(here: Path, cli: Cli) -> None:
    figures = cli.json("capture check captures --report page")
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
    out = cli("capture check captures", code=1).out.replace("\n", " ")
    assert "error: the radius of the ball is not stated" in out
    assert "blocked" in out and "[red]" not in out


def test_a_plain_folder_is_checked_as_it_stands_and_imported(here: Path, cli: Cli) -> None:
    (here / "captures" / "captures.toml").unlink()
    before = everything_below(here)
    figures = cli.json("capture check captures", code=1)
    assert figures["contents"]["ball_presses"] == 5 and figures["contents"]["background"] == 1
    assert any("read as plain" in note for note in figures["notes"])
    assert everything_below(here) == before
    facts = "--sensor gelsight --radius-mm 2 --mm-per-px-x 0.1"
    printed = cli.json(f"capture import captures out {facts}")
    assert printed["layout"] == "plain"
    assert printed["folders"][0]["contents"]["ball_presses"] == 5
    cli("capture check out --json")


@pytest.mark.parametrize("name", ["rvsathu", "ruihangao"])
def test_the_layout_that_is_proposed_is_ours(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    """Not a script of a stranger's folder, whatever its name, where the proposal is followed."""
    source = source_of(name, tmp_path)
    monkeypatch.chdir(source)
    for script in (f"docs/examples/layouts/{name}.py", f"{name}.py", name):
        (source / script).parent.mkdir(parents=True, exist_ok=True)
        (source / script).write_text("open('run', 'w')\n")
    proposed = re.search(r"add (--layout \S+?),? ", cli.refusal("capture import . ../out"))
    assert proposed is not None
    cli(f"capture import . ../out {proposed[1]}")
    assert not (source / "run").exists()
    assert f"layout {name}" in (tmp_path / "out" / "captures.toml").read_text()


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
    cli("capture import shear.avi out")
    assert out.is_dir() and counted and not any(counted)


@pytest.mark.thorough
def test_the_report_of_several_sets_is_one_output(here: Path, cli: Cli) -> None:
    """It is replaced by the next one, and there as a whole or not at all."""
    for name in ("a[green]", "b"):
        write_captures(here / "both" / name)
    assert len(cli.json("capture check both")["parts"]) == 2
    for _ in range(2):
        said = cli("capture check both --report page")
        assert "both/a[green]/captures.toml (" in said.out
        assert "wrote page/b/report.html" in said.err
    pages = sorted(path.parent.name for path in (here / "page").rglob("report.html"))
    assert pages == ["a[green]", "b"]
    before = everything_below(here / "page")
    (here / "both" / "b" / "captures.toml").write_text("torn")
    cli("capture check both --report page", code=2)
    assert everything_below(here / "page") == before


@pytest.mark.thorough
def test_several_sets_of_a_layout_have_pages_of_their_own_names(here: Path, cli: Cli) -> None:
    """Not those of the passing folders that they are read from."""
    names = ["left", "right"]
    (here / "captures" / "captures.toml").unlink()
    read = importers.read_drafts

    def twice(*words: object) -> tuple[str, list[Draft]]:
        layout, drafts = read(*words)  # type: ignore[arg-type]
        return layout, [replace(draft, part=name) for name in names for draft in drafts]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(importers, "read_drafts", twice)
        said = cli("capture check captures --report page", code=1)
    assert sorted(path.parent.name for path in (here / "page").rglob("report.html")) == names
    assert "taccel_lab_" not in said.out + said.err
    assert "taccel_lab_" not in (here / "page" / "left" / "report.html").read_text()


def test_guide_writes_a_manifest(here: Path, cli: Cli) -> None:
    out = cli("capture guide 9dtact --out new.toml").out
    assert "minutes in all" in out and "Board of dots" in out
    assert 'sensor = "9dtact"' in (here / "new.toml").read_text()
    assert cli.json("capture guide digit_360")["minutes"] < 60
    # What is measured, and can be taken for nothing else.
    indenter = tomllib.loads((here / "new.toml").read_text(encoding="utf-8"))["indenter"]
    assert indenter["diameter_mm"] > 0 and "radius_mm" not in indenter


def test_devices_are_listed(cli: Cli) -> None:
    assert isinstance(cli.json("capture devices")["cameras"], list)


FACTS = "--camera set --out out --radius-mm 2 --mm-per-px-x 0.1 --no-page"
RECORD = f"capture record flat_pad {FACTS}"


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a ``set`` of two presses to record from."""
    monkeypatch.chdir(tmp_path)
    source(tmp_path / "set", 2)
    return tmp_path


@pytest.mark.thorough
def test_a_session_is_recorded_and_goes_on(bench: Path, cli: Cli) -> None:
    printed = cli(f"{RECORD} --presses 1 --json")
    assert json.loads(printed.out)["presses"] == 1
    assert "Touch nothing" in printed.err and "Press next" in printed.err
    found = cli.json(f"{RECORD} --presses 3")
    assert found["presses"] == 3 and found["contents"]["background"] == 1
    told = cli.refusal(f"{RECORD} --radius-mm 2.5")
    assert "begun otherwise: --radius-mm was 2.0 and is 2.5" in told


@pytest.mark.thorough
def test_quick_says_what_it_leaves_out(bench: Path, cli: Cli) -> None:
    printed = cli(f"capture quick flat_pad {FACTS}")
    assert "leaves out" in printed.err and "no load cell" in printed.err
    assert "2 of 20 presses" in printed.out and "same command continues it" in printed.out
    assert "# - force" in (bench / "out" / "captures.toml").read_text()


@pytest.mark.thorough
def test_what_was_taken_is_told_whatever_ends_it(
    bench: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(RecordFolder, "add_press", full)
    said = cli.refusal(RECORD)
    assert "out stays with 0 of" in said and "and the same command continues it" in said
    assert "No space left" in said


@pytest.mark.thorough
def test_lamps_are_printed_where_there_is_no_page(bench: Path, cli: Cli) -> None:
    folder = load_capture_folder(bench / "set")
    dim = np.rint(0.8 * folder.presses[0].image()).astype(np.uint8)
    write_image(bench / "set" / "p00.png", dim)
    lines = cli(RECORD).err.splitlines()
    assert sum(line.startswith("drift: ") for line in lines) == 1


def test_labels_that_were_clicked_are_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    """Done is pressed at once, with nothing saved, and after one press was left out."""
    pytest.importorskip("viser", reason="the extra view is not installed")
    folder = write_captures(tmp_path / "set")
    name = "taccel_lab.calibration.record.label_page.LabelPage"
    monkeypatch.setattr(name, _done_at_once)
    words = ("capture label", folder, "--port", "0", "--no-browser")
    assert cli(*words).out == "0 presses corrected\n"

    def leave_out(server: object, labelling: Labelling, dark: bool) -> SimpleNamespace:
        labelling.leave_out()
        return _done_at_once()

    monkeypatch.setattr(name, leave_out)
    printed = cli(*words).out
    assert "1 press corrected in" in printed and "next: taccel-lab capture check" in printed
    assert cli.json(*words)["saved"] == {"p0": None}


def _done_at_once(*_: object) -> SimpleNamespace:
    done = threading.Event()
    done.set()
    return SimpleNamespace(done=done)
