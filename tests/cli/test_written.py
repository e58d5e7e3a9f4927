# SPDX-License-Identifier: Apache-2.0
"""What commands write: by the user's umask, through no link, and not in the place of captures."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.files.output_folder import CAPTURES
from tests.cli.conftest import Cli
from tests.support.capture_sets import write_image

WRITTEN = {
    "a file": "capture guide gelsight --out new/guide.toml",
    "captures": "capture import plain new/captures --layout plain",
    "a report": "capture check captures --report new/page",
    "an export": "export bare --to urdf --out new/export",
    "a profile": "calibrate background captures --out new/profile",
    "a study": "study thickness.toml --out new/study",
}
"""Commands that write, in the working folder."""


@pytest.fixture(params=[0o077, 0o022, 0o007], ids=oct)
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


@pytest.mark.thorough(cases=("profile", "study", "report"))
@pytest.mark.parametrize("what", WRITTEN)
def test_files_and_folders_have_the_users_permissions(
    what: str, umask: int, room: Path, here: Path, study: Path, cli: Cli
) -> None:
    for name in ("plain", "bare"):
        shutil.copytree(room / name, here / name)
    cli(WRITTEN[what])
    found = [here / "new", *(here / "new").rglob("*")]
    modes = {path: stat.S_IMODE(path.stat().st_mode) for path in found}
    assert modes == {path: (0o777 if path.is_dir() else 0o666) & ~umask for path in found}
    assert any(path.is_file() for path in found)


def begun_study(here: Path, room: Path) -> str:
    (here / "out").mkdir()
    shutil.copy(room / "study.toml", here / "out")
    return f"study {room}/study.toml --processes 1 --out out"


def begun_shard(here: Path, room: Path) -> str:
    words = begun_study(here, room)
    (here / "out" / ".taccel_lab_study").write_text("1\n")
    return f"{words} --shard 1/2"


def begun_data_set(here: Path, room: Path) -> str:
    (here / "out").mkdir()
    (here / "out" / ".mine").write_text("mine")
    return f"dataset {room}/set.toml --out out"


def begun_readings(here: Path, room: Path) -> str:
    (here / ".mine").write_text("mine")
    (here / "frames").mkdir()
    write_image(here / "frames" / "rest.png", np.full((240, 320, 3), 90, np.uint8))
    return "read gelsight_mini frames --background frames/rest.png --out out"


def begun_recording(here: Path, room: Path) -> str:
    shutil.copytree(here / "captures", here / "out")
    (here / "out" / CAPTURES).rename(here / "out" / "mine.toml")
    return "capture record flat_pad --camera captures --no-page --out out"


def begun_labels(here: Path, room: Path) -> str:
    shutil.copytree(here / "captures", here / "out")
    (here / "out" / "mine.toml").write_text('[[contact]]\npress = "p0"\nskip = true\n')
    return "capture label out --no-browser --port 0"


GROWING: dict[str, tuple[Callable[[Path, Path], str], str, str]] = {
    "a study": (begun_study, "out/.taccel_lab_study", "study.toml"),
    "a study's shard": (begun_shard, "out/.shard_1_of_2", "study.toml"),
    "a data set": (begun_data_set, "out/.lock-1-of-1", ".mine"),
    "readings": (begun_readings, ".out.readings.jsonl", ".mine"),
    "a recording": (begun_recording, f"out/{CAPTURES}", "mine.toml"),
    "labels": (begun_labels, "out/contacts.toml", "mine.toml"),
}
"""What has begun a folder that stays, a file that its command goes on with, and one beside it."""


@pytest.mark.usefixtures("places")
@pytest.mark.parametrize("what", GROWING)
def test_a_link_is_not_written_through(
    what: str, room: Path, here: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("taccel_lab.report.live_page.serve_until_stopped", lambda done: None)
    begin, name, other = GROWING[what]
    words = begin(here, room)
    link = here / name
    link.symlink_to(other)
    before = link.read_bytes()
    assert f"{link.name} is a link; put the file itself there" in cli.refusal(words)
    assert link.is_symlink() and link.read_bytes() == before


@pytest.mark.parametrize("command", ["capture import captures out --layout plain", "press"])
def test_captures_are_replaced_when_it_is_asked_for(command: str, here: Path, cli: Cli) -> None:
    """An import of 5 images, then one of a folder of 3, and outputs of other commands."""
    (here / "captures" / CAPTURES).unlink()
    cli("capture import captures out --layout plain")
    for number in range(2):
        (here / "captures" / f"p{number}.png").unlink()
    if command == "press":
        command = "press gelsight --depth-mm 0.1 --out out"
    cli.refuses(["out holds captures; name another folder", "--replace"], command)
    assert len(load_capture_folder(here / "out").presses) == 5
    if "import" in command:
        cli(command, "--replace")
        assert len(load_capture_folder(here / "out").presses) == 3
        # What a person did since is kept all the same.
        with open(here / "out" / CAPTURES, "a") as manifest:
            manifest.write("# p2 slipped\n")
        cli.refuses([f"were changed since: {CAPTURES}"], command, "--replace")
