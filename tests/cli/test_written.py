# SPDX-License-Identifier: Apache-2.0
"""What commands write: by the user's umask, through no link, not in the place of captures, and not
into a cache that they do not need."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.cli.console import notes, say_first_look
from taccel_lab.files.file_cache import CACHE_VARIABLE, cached_arrays
from taccel_lab.files.output_folder import CAPTURES
from taccel_lab.profile import load_profile, save_profile
from tests.cli.conftest import Cli
from tests.exporters.profiles import mini_profile
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


@pytest.fixture
def no_cache(monkeypatch: pytest.MonkeyPatch, forbid: Callable[[str], None]) -> None:
    """A cache folder that cannot be written; a command that starts Warp would end there."""
    monkeypatch.setenv(CACHE_VARIABLE, "/proc/cache")
    forbid("taccel_lab.processes.start_warp.start_warp")


@pytest.mark.thorough(cases=("onnx", "safetensors", "tacto", "taccel"))
@pytest.mark.parametrize("to", ["onnx", "opencv", "safetensors", "taccel", "tacto", "urdf"])
@pytest.mark.usefixtures("no_cache")
def test_an_export_without_kernels_needs_no_cache(to: str, tmp_path: Path, cli: Cli) -> None:
    if to == "onnx":
        pytest.importorskip("onnx")
    save_profile(mini_profile(), tmp_path / "mini")
    cli("export", tmp_path / "mini", "--to", to, "--out", tmp_path / "out")
    assert (tmp_path / "out" / "export.json").is_file()


@pytest.mark.usefixtures("no_cache")
def test_a_calibration_without_kernels_needs_no_cache(here: Path, cli: Cli) -> None:
    cli("calibrate background captures --out out")
    assert load_profile(here / "out").background is not None


@pytest.mark.usefixtures("no_cache")
def test_what_a_cache_only_quickens_needs_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.warns(UserWarning, match="things are made anew each time: cannot write the cache"):
        made = cached_arrays("things", {"n": 1}).read_or_make(lambda: {"a": np.arange(3.0)})
    assert made["a"].shape == (3,)
    (tmp_path / "picture.png").write_bytes(b"")
    say_first_look(notes(), tmp_path / "picture.png")
    assert "first look" not in capsys.readouterr().err
