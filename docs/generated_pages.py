# SPDX-License-Identifier: Apache-2.0
"""Pages that are made from elsewhere: every command's --help, and the executed notebooks."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import textwrap
from pathlib import Path

from taccel_lab.cli.app import Group, command_tree, parse

_NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
_WIDTH = 96
_STYLE = re.compile(r"\x1b\[[0-9;]*m")


def write(folder: Path) -> None:
    """Write a page a command or group of commands, their table (``commands.md``), the notebooks."""
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for name, command in command_tree().items():
        inner = list(command.commands) if isinstance(command, Group) else []
        text = f"# taccel-lab {name}\n\n{_help([name])}"
        for word in inner:
            text += f"\n## taccel-lab {name} {word}\n\n{_help([name, word])}"
        _keep(folder / f"{name}.md", text)
        names.append(name)
    listed = "\n".join(names)
    for notebook in sorted(_NOTEBOOKS.glob("*.ipynb")):
        shutil.copy2(notebook, folder / notebook.name)
    table = f"# Commands\n\n{_help([])}\n```{{toctree}}\n:maxdepth: 2\n\n{listed}\n```\n"
    _keep(folder / "commands.md", table)


def _help(words: list[str]) -> str:
    """What --help prints, as a block of text."""
    printed = io.StringIO()
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(_WIDTH)
    try:
        with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
            parse([*words, "--help"])
    finally:
        os.environ.pop("COLUMNS")
        if before is not None:
            os.environ["COLUMNS"] = before
    lines = _STYLE.sub("", printed.getvalue()).strip().splitlines()
    text = "\n".join(part for line in lines for part in _wrapped(line))
    return f"```text\n{text}\n```\n"


def _wrapped(line: str) -> list[str]:
    """The line, or several where it is prose that is too long."""
    return textwrap.wrap(line, _WIDTH) if len(line) > _WIDTH else [line]


def _keep(path: Path, text: str) -> None:
    """Write the page unless it is the same: an unchanged page is not read again."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
