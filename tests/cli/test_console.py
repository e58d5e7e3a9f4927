# SPDX-License-Identifier: Apache-2.0
"""What commands print is what was said: file sections in brackets are no markup."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console
from rich.table import Table

import taccel_lab.cli
from taccel_lab.cli.console import be_quiet, notes, results, say_first_look, working
from taccel_lab.output_folder import atomic_directory

SENTENCE = "write thickness_mm under [design], radius_mm under [indenter]; [/] [red] 3/4"


@pytest.mark.parametrize("console", [results, notes])
def test_brackets_are_printed(
    console: Callable[[], Console], capsys: pytest.CaptureFixture[str]
) -> None:
    table = Table("[block]", title="[material]", width=120)
    table.add_row(SENTENCE)
    shown = console()
    shown.print(SENTENCE, soft_wrap=True)
    shown.print(table, soft_wrap=True)
    with working(shown, SENTENCE):  # It would be an error of rich's markup.
        pass
    told = "".join(capsys.readouterr())
    assert told.count(SENTENCE) == 2
    assert "[block]" in told and "[material]" in told


def test_nothing_is_noted_when_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    be_quiet(True)
    try:
        notes().print("how far it is")
        results().print("what was found")
    finally:
        be_quiet(False)
    told = capsys.readouterr()
    assert told.err == "" and told.out == "what was found\n"


COMMANDS = sorted(Path(taccel_lab.cli.__file__).parent.rglob("*.py"))


@pytest.mark.parametrize("words", ["Console(", ".status(", "from_markup"])
def test_no_command_prints_in_a_way_of_its_own(words: str) -> None:
    """A console of its own would take brackets as markup again, as its turning signs do."""
    own = [path.name for path in COMMANDS if words in path.read_text(encoding="utf-8")]
    assert [name for name in own if name != "console.py"] == []


def test_nothing_that_is_printed_is_written_in_markup() -> None:
    """It would be printed as it stands: a colour is a ``Text`` with a style."""
    marked = [
        f"{path.name}:{node.lineno}: {node.value}"
        for path in COMMANDS
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        if re.search(r"\[/|\[(bold|dim|italic|red|green|yellow|cyan|blue|magenta)\b", node.value)
    ]
    assert marked == []


def test_a_first_look_stays_where_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The folder that is being written has a hidden name, which is gone with the next line."""
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(tmp_path / "cache"))
    for picture in (b"one", b"another"):
        with atomic_directory(tmp_path / "out") as folder:
            (folder / "scene.png").write_bytes(picture)
            say_first_look(notes(), folder / "scene.png")
        told = capsys.readouterr().err.strip().removeprefix("first look: ")
        assert Path(told).read_bytes() == picture and "/." not in told.removeprefix(str(tmp_path))
    assert len(list((tmp_path / "cache").rglob("*.png"))) == 1
