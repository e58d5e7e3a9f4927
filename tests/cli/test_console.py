# SPDX-License-Identifier: Apache-2.0
"""What commands print is what was said: file sections in brackets are no markup."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console
from rich.table import Table

import taccel_lab.cli
from taccel_lab.cli.console import be_quiet, notes, results

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


def test_no_command_prints_in_a_way_of_its_own() -> None:
    """A console of its own would take brackets as markup again."""
    folder = Path(taccel_lab.cli.__file__).parent
    own = [
        str(path.relative_to(folder))
        for path in folder.rglob("*.py")
        if path.name != "console.py" and "Console(" in path.read_text(encoding="utf-8")
    ]
    assert own == []
