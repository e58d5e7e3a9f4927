# SPDX-License-Identifier: Apache-2.0
"""Progress bars of long commands; lines now and then where no terminal draws bars."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

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
            console.print(f"{where or title} ({seconds:.0f} s)", highlight=False, markup=False)

    console.print(f"{title} ...", highlight=False, markup=False)
    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield state
    finally:
        stop.set()
        thread.join()


@contextmanager
def _bars(
    console: Console, title: str, first: str | None = None
) -> Iterator[Callable[[str, int, int, str], None]]:
    """Yield a callback (task, done, in all, note) that draws a bar for each task.

    ``first`` is a task whose bar is there before anything of it is done.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
    )
    with _beats(console, title) as said, Progress(*columns, console=console) as bar:
        tasks = {} if first is None else {first: bar.add_task(first, total=None, note="")}

        def update(task: str, done: int, total: int, note: str) -> None:
            said.pop(task, None)
            said[task] = f"{done}/{total} {note}".strip()
            if task not in tasks:
                tasks[task] = bar.add_task(task, total=None, note=note)
            bar.update(tasks[task], completed=done, total=total, note=note)

        yield update


@contextmanager
def stage_progress(console: Console) -> Iterator[Callable[[str, int, int], None]]:
    """Yield a callback (task, done, in all) that draws a bar for each task."""
    with _bars(console, "reading") as update:
        yield lambda task, done, total: update(task, done, total, "")


@contextmanager
def count_progress(console: Console, title: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a callback (done, in all) that draws a bar."""
    with _bars(console, title, title) as update:
        yield lambda done, total: update(title, done, total, "")


@contextmanager
def fit_progress(console: Console, title: str) -> Iterator[Callable[[int, int, float], None]]:
    """Yield a callback (steps done, steps in all, loss) that draws a bar with the loss beside."""
    with _bars(console, title, title) as update:
        yield lambda done, total, loss: update(title, done, total, f"loss {loss:.2f}")
