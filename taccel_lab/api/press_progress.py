# SPDX-License-Identifier: Apache-2.0
"""A bar over the steps of a press, with the figures of the latest step beside it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from taccel_lab.processes.start_warp import first_step
from taccel_lab.progress import watching_console

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.presses.press_force import StepProgress
    from taccel_lab.presses.press_outcome import PressStep


@contextmanager
def step_progress(console: Console, title: str) -> Iterator[StepProgress]:
    """Yield a callback that draws each step."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(title, total=None, note=first_step())

        def update(done: int, total: int, step: PressStep) -> None:
            report = step.report
            note = (
                f"depth {step.depth_mm:.2f} mm, force {step.wrench[2] + 0.0:.3g} N, residual "
                f"{report.residual_n[0]:.1e} N, {report.newton_iterations[0]} Newton, "
                f"{report.seconds:.2f} s"
            )
            progress.update(task, completed=done, total=total, note=note)

        yield update


@contextmanager
def steps_if_watched(progress: StepProgress | None, title: str) -> Iterator[StepProgress | None]:
    """Yield ``progress``; where it is None, a bar on a terminal or in a notebook, else nothing."""
    console = None if progress is not None else watching_console()
    if console is None:
        yield progress
        return
    with step_progress(console, title) as bar:
        yield bar
