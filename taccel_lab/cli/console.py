# SPDX-License-Identifier: Apache-2.0
"""Output shared by the commands, and where they keep what they have finished."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from taccel_lab.errors import InputError, keeping
from taccel_lab.files.atomic_file import to_jsonable

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.status import Status


_settings = {"quiet": False}
_results: list[IO[str]] = []
"""Where ``print_json`` writes when standard output is for it alone; empty otherwise."""


def be_quiet(quiet: bool) -> None:
    """Whether commands leave out how far they are and what they noted; errors are said anyway."""
    _settings["quiet"] = quiet


def results() -> Console:
    """Where a command says what it found: standard output, words as they are."""
    from taccel_lab.plain_console import PlainConsole

    return PlainConsole()


def notes() -> Console:
    """Where a command says how far it is and what it noted: standard error, nothing when quiet;
    words as they are."""
    from taccel_lab.plain_console import PlainConsole

    return PlainConsole(stderr=True, quiet=_settings["quiet"])


def say(words: str) -> None:
    """Note a line, which is not broken to the width of a terminal."""
    notes().print(words, soft_wrap=True)


def print_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[RenderableType]],
    title: str = "",
    to: Console | None = None,
) -> None:
    """Write a table to ``results()``, or ``to`` another console; its first column has the names,
    and long cells are folded."""
    from rich import box
    from rich.table import Table

    table = Table(title=title or None, title_justify="left", box=box.SIMPLE)
    for column in columns:
        table.add_column(column, overflow="fold")
    table.columns[0].style = "cyan"
    table.columns[0].no_wrap = True
    for row in rows:
        table.add_row(*row)
    (to or results()).print(table)


def print_json(value: Any) -> None:
    """Write ``value`` as indented JSON to standard output; NaN and infinities become null."""
    out = _results[-1] if _results else sys.stdout
    out.write(json.dumps(to_jsonable(value), indent=2, allow_nan=False) + "\n")
    out.flush()


def working(console: Console, words: str) -> Status:
    """Words beside a turning sign while the block runs, on a terminal alone; brackets are no
    markup there either, as rich would have it."""
    from rich.text import Text

    return console.status(Text(words))


def say_first_look(console: Console, picture: Path) -> None:
    """Tell where a picture lies that can be looked at while the command goes on, and after it: a
    copy in the cache folder, as a folder that is being written has a hidden name, which goes. None
    is told of where that folder cannot be written."""
    from taccel_lab.files.file_cache import keep_file

    with suppress(InputError):
        if not console.quiet:
            console.print(f"first look: {keep_file('first_look', picture)}", soft_wrap=True)


@contextmanager
def only_json() -> Iterator[None]:
    """Standard output is for ``print_json`` alone: all else goes to standard error, whoever writes
    it, a table, Warp, a library in C or a process of ours."""
    sys.stdout.flush()
    try:
        number = sys.stdout.fileno()
        kept = os.dup(number)
    except (io.UnsupportedOperation, OSError):
        # No file, as where the output of a call is collected.
        _results.append(sys.stdout)
        try:
            with redirect_stdout(sys.stderr):
                yield
        finally:
            _results.pop()
        return
    os.dup2(2, number)
    with os.fdopen(os.dup(kept), "w", errors="backslashreplace") as out:
        _results.append(out)
        try:
            yield
        finally:
            _results.pop()
            with suppress(OSError):
                sys.stdout.flush()
            os.dup2(kept, number)
            os.close(kept)


@contextmanager
def kept_blocks(folder: Path) -> Iterator[Path]:
    """The place beside ``folder``; an early end says what is kept there."""
    beside = Path(os.path.abspath(folder))  # "." has no name.
    unfinished = beside.with_name(f"{beside.name}_unfinished")

    def what() -> str:
        kept = f"finished blocks stay in {unfinished}, where the same command continues"
        return kept if unfinished.exists() else ""

    with keeping(what):
        yield unfinished
