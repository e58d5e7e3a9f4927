# SPDX-License-Identifier: Apache-2.0
"""With --json standard output is JSON and nothing else, whoever writes, also where it fails."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from taccel_lab.calibration.capture.schema import MANIFEST_NAME
from taccel_lab.cli import app
from taccel_lab.profile import save_profile
from tests.sensors.imported_profiles import imported
from tests.support.synthetic_presses import synthetic_captures, write_captures

CHEAP = {
    "capture check": ["CAPTURES"],
    "capture devices": [],
    "capture guide": ["gelsight_mini"],
    "capture import": ["CAPTURES", "OUT", "--layout", "plain"],
    "capture review": ["CAPTURES", "--out", "OUT"],
    "doctor": [],
    "export": ["PROFILE", "--to", "taxim", "--out", "OUT"],
    "preview": ["PROFILE", "--out", "OUT", "--presses", "--size-px", "64"],
    "profile compare": ["PROFILE", "PROFILE"],
    "profile report": ["PROFILE", "--out", "OUT"],
    "profile show": ["PROFILE"],
    "profile validate": ["PROFILE"],
    "robot list": [],
    "robot show": ["panda"],
    "sensors list": [],
    "sensors show": ["gelsight"],
    "study": ["--list-presses"],
    "task list": [],
}
"""Words behind commands that are done within seconds, or refuse them for a reason of their own."""


def json_commands() -> Iterator[str]:
    for name, found in app.command_tree().items():
        inner = found.commands if isinstance(found, app.Group) else {"": found}
        for word, command in inner.items():
            if "json" in {f.name for f in dataclasses.fields(command)}:  # type: ignore[arg-type]
                yield f"{name} {word}".strip()


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("json")
    save_profile(imported(), folder / "profile")
    write_captures(folder / "captures", synthetic_captures(count=3)[0])
    assert (folder / "captures" / MANIFEST_NAME).is_file()
    return {"PROFILE": str(folder / "profile"), "CAPTURES": str(folder / "captures")}


def run(words: list[str]) -> int:
    try:
        return app.main(words)
    except SystemExit as end:
        return int(end.code or 0)


@pytest.mark.parametrize("command", sorted(CHEAP))
def test_what_is_printed_is_json(
    command: str, places: dict[str, str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    known = {**places, "OUT": str(tmp_path / "out")}
    words = [known[word] if word in known else word for word in CHEAP[command]]
    code = run([*command.split(), *words, "--json"])
    said, noted = capfd.readouterr()
    if code in (0, 1):
        json.loads(said)
    else:
        assert said == "" and noted


def test_no_command_has_left_the_list() -> None:
    assert set(CHEAP) <= set(json_commands())


@pytest.mark.parametrize("command", list(json_commands()))
def test_a_command_that_fails_prints_nothing(
    command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run([*command.split(), "--json", "--no-such-option", "1"]) == 2
    said, noted = capfd.readouterr()
    assert said == "" and noted


BESIDE = """
import os, subprocess, sys
from taccel_lab.cli.console import only_json, print_json
with only_json():
    print("a table")
    os.write(1, b"a library in C\\n")
    subprocess.run([sys.executable, "-c", "print('a process of ours')"], check=True)
    print_json({"a": 1})
    print("a banner")
print("afterwards")
"""


def test_whoever_writes_beside_it_is_sent_to_standard_error() -> None:
    command = [sys.executable, "-c", BESIDE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout.endswith("afterwards\n")
    assert json.loads(done.stdout.removesuffix("afterwards\n")) == {"a": 1}
    for words in ("a table", "a library in C", "a process of ours", "a banner"):
        assert words in done.stderr


def test_a_reader_that_has_enough_of_the_json() -> None:
    command = f"{sys.executable} -m taccel_lab.cli.app sensors list --json | head -c 1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("{", "")
