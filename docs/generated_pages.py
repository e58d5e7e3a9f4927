# SPDX-License-Identifier: Apache-2.0
"""Pages that are made from elsewhere: every command's --help, and the executed notebooks."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import re
import textwrap
from pathlib import Path

from PIL import Image, ImageOps

from taccel_lab.cli.app import Group, command_tree, parse

_NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
_THUMBNAIL_PX = (340, 220)
_WIDTH = 96
_STYLE = re.compile(r"\x1b\[[0-9;]*m")


def write(folder: Path) -> None:
    """Write a page a command or group of commands, their table (``commands.md``), the notebooks and
    their gallery (``gallery.inc``)."""
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
    rows = []
    for notebook in sorted(_NOTEBOOKS.glob("*.ipynb")):
        text = notebook.read_text(encoding="utf-8")
        rows.append(_gallery_row(notebook.stem, json.loads(text)["cells"], folder))
        # Links to pages are those of the repository.
        _keep(folder / notebook.name, text.replace("(../docs/", "(../../"))
    _keep(folder / "gallery.inc", f"```{{list-table}}\n:widths: 30 70\n\n{''.join(rows)}```\n")
    table = f"# Commands\n\n{_help([])}\n```{{toctree}}\n:maxdepth: 2\n\n{listed}\n```\n"
    _keep(folder / "commands.md", table)


def _gallery_row(name: str, cells: list[dict], folder: Path) -> str:
    """Title, first sentence and a small picture: the output with most to see. Paths as in docs/."""
    title, _, words = "".join(cells[0]["source"]).partition("\n")
    sentence = re.split(r"(?<=[.?]) ", " ".join(words.split()))[0]
    outputs = [output for cell in cells for output in cell.get("outputs", ())]
    pictures = [o["data"]["image/png"] for o in outputs if "image/png" in o.get("data", {})]
    picture = Image.open(io.BytesIO(base64.b64decode(max(pictures, key=len)))).convert("RGB")
    # Of wide figures the left, in which the first of their pictures is.
    ImageOps.fit(picture, _THUMBNAIL_PX, centering=(0.0, 0.0)).save(folder / f"{name}.png")
    page = f"reference/generated/{name}"
    link = f"[{title.removeprefix('# ')}]({page}.ipynb)"
    return f"* - [![{name}]({page}.png)]({page}.ipynb)\n  - **{link}** <br> {sentence}\n"


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
