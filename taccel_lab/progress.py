# SPDX-License-Identifier: Apache-2.0
"""Progress of long work: callbacks, and bars in terminals and notebooks; lines in logs."""

from __future__ import annotations

import importlib.util
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[str, int, int], None]
"""Called with the name of the task, how much of it is done, and how much there is in all."""

Item = TypeVar("Item")

BEAT_S = 20.0
"""Time between two lines of a long step in a log [s]."""


def silent(task: str, done: int, total: int) -> None:
    """Tells nobody."""


def counted(items: Iterable[Item], progress: Progress, task: str, total: int) -> Iterator[Item]:
    """The items, each counted when the next one is asked for; at their end the task is done."""
    done = 0
    for done, item in enumerate(items, 1):
        yield item
        progress(task, done, total)
    if done < total:
        progress(task, total, total)


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
        after: list[Any] = []

        def update(task: str, done: int, total: int) -> None:
            said.pop(task, None)
            said[task] = f"{done}/{total}"
            while after:
                bars.remove_task(after.pop())
            if task not in tasks:
                tasks[task] = bars.add_task(task, total=None)
            bars.update(tasks[task], completed=done, total=total)
            if total and done >= total:
                # A full bar is no end of the work: the rest has its own clock.
                block = task.rpartition(": ")[0]
                words = f"{block}: finishing" if block else "finishing"
                after.append(bars.add_task(words, total=None))
                said[words] = ""

        try:
            yield update
        finally:
            while after:
                bars.remove_task(after.pop())


@contextmanager
def bars_if_watched(progress: Progress | None) -> Iterator[Progress]:
    """Yield ``progress``; where it is None, bars on a terminal or in a notebook, else nothing."""

    if progress is not None:
        yield progress
        return
    console = watching_console()
    if console is None:
        yield silent
        return
    with stage_progress(console) as bars:
        yield bars


def watching_console() -> Console | None:
    """Where somebody sees how far a call of a script or a notebook is; None for nobody."""
    from taccel_lab.plain_console import PlainConsole

    in_notebook = "ipykernel" in sys.modules
    if in_notebook and importlib.util.find_spec("ipywidgets") is None:
        return None  # Bars that cannot be drawn again would fill the cell.
    console = PlainConsole(stderr=not in_notebook)
    return console if console.is_terminal or console.is_jupyter else None
