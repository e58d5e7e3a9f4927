# SPDX-License-Identifier: Apache-2.0
"""Progress bars of long commands; lines now and then where no terminal draws bars."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.progress import Progress

BEAT_S = 20.0
"""Time between two lines of a long step in a log [s]."""


@contextmanager
def _beats(console: Console, title: str) -> Iterator[dict[str, str]]:
    """Lines in a log that say what goes on, as rich draws a bar there at the end only.

    Yields a table of what to say: step by step, how far it is.
    """
    state: dict[str, str] = {}
    if console.is_terminal:
        yield state
        return
    stop, started = threading.Event(), time.monotonic()

    def beat() -> None:
        while not stop.wait(BEAT_S):
            where = ", ".join(" ".join(item).strip() for item in tuple(state.items())[-1:])
            seconds = time.monotonic() - started
            console.print(f"{where or title} ({seconds:.0f} s)")

    console.print(f"{title} ...")
    thread = threading.Thread(target=beat, name="progress", daemon=True)
    thread.start()
    try:
        yield state
    finally:
        stop.set()
        thread.join()


@contextmanager
def stage_words(console: Console) -> Iterator[Callable[[str], None]]:
    """Yield what says the stage that begins: a clock runs beside it, a log gets a line of each."""
    from rich.progress import Progress as Bars
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    if not console.is_terminal:
        said: list[str] = []

        def note(words: str) -> None:
            if said[-1:] != [words]:
                said.append(words)
                console.print(f"{words} ...", soft_wrap=True)

        yield note
        return
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with Bars(*columns, console=console, transient=True) as bars:
        task = bars.add_task("starting", total=None)
        yield lambda words: bars.update(task, description=words)


@contextmanager
def stage_progress(console: Console) -> Iterator[Progress]:
    """Yield a callback (task, done, in all) that draws a bar for each task."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with _beats(console, "reading") as said, Bars(*columns, console=console) as bars:
        tasks: dict[str, Any] = {}

        def update(task: str, done: int, total: int) -> None:
            said.pop(task, None)
            said[task] = f"{done}/{total}"
            if task not in tasks:
                tasks[task] = bars.add_task(task, total=None)
            bars.update(tasks[task], completed=done, total=total)

        yield update
