# SPDX-License-Identifier: Apache-2.0
"""Paths that lead nowhere, and names that no file can have: told in words by every command."""

from __future__ import annotations

from pathlib import Path

import pytest

from taccel_lab.cli.app import main

READERS = [
    "capture review BAD",
    "capture review BAD --out OUT",
    "capture check BAD",
    "capture import BAD OUT",
    "calibrate color BAD --out OUT",
    "calibrate force BAD --out OUT",
    "dataset check BAD",
    "dataset BAD --check-only",
    "dataset lite BAD --out OUT",
    "study BAD --out OUT",
    "view BAD --no-browser",
    "profile show BAD",
    "export BAD --to taxim --out OUT",
    "robot show BAD",
    "import-step BAD",
]
BAD = {"a link to itself": "loop", "below one": "loop/x", "too long": "x" * 300, "NUL": "a\0b"}


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("command", READERS)
def test_it_is_refused(
    command: str,
    bad: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    words = [BAD[bad] if word == "BAD" else word.replace("OUT", "out") for word in command.split()]
    try:
        code = main(words)
    except SystemExit as left:  # Of the parser.
        code = left.code
    assert code == 2
    assert capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["loop"]


def test_a_file_that_is_no_text_is_named_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", str(tmp_path / "\udcff.toml")]) == 2
    assert capsys.readouterr().err.count("udcff") == 1
