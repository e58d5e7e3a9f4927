# SPDX-License-Identifier: Apache-2.0
"""What ``taccel-lab study`` shows while it works and when it is done."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from taccel_lab.studies.evaluate.runner import Listener

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.studies.evaluate.design_row import DesignRow
    from taccel_lab.studies.evaluate.runner import StudyOutcome
    from taccel_lab.studies.spec.study import Study


LINE_EVERY_S = 20.0
"""Where there is no terminal to draw a bar on, a line is written at most this often."""


class StudyProgress(Listener):
    """A bar over the designs with the time left and the failures, and a line a process."""

    def __init__(self, console: Console, study: Study) -> None:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self._console = console
        self._study = study
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}", markup=False),
            console=console,
            speed_estimate_period=3600,
        )
        self._task: Any = None
        self._workers: dict[int, Any] = {}
        self._total = self._done = self._lost = 0
        self._begun = self._line_at = time.monotonic()

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()

    def begins(self, total: int, there: int, to_do: int) -> None:
        from rich.text import Text

        if there:
            self._bar.console.print(
                Text(f"{there} of {total} designs are there already, {to_do} to do")
            )
        self._total, self._begun = to_do, time.monotonic()
        self._task = self._bar.add_task("designs", total=to_do, note="")

    def finished(self, design: DesignRow) -> None:
        from rich.text import Text

        if design.status != "done":
            self._lost += 1
            name = self._study.name_of(design.parameters)
            self._bar.console.print(Text(f"{name} {design.status}: {design.cause}"))
        self._done += 1
        self._write_line()
        note = f"{self._lost} failed" if self._lost else ""
        self._bar.update(self._task, advance=1, note=note)

    def _write_line(self) -> None:
        now = time.monotonic()
        last = self._done == self._total
        if self._console.is_terminal or (now - self._line_at < LINE_EVERY_S and not last):
            return
        self._line_at = now
        spent = now - self._begun
        left = spent * (self._total - self._done) / self._done
        self._console.print(
            f"{self._done} of {self._total} designs, {self._lost} failed, {spent:.0f} s spent, "
            f"about {left:.0f} s left",
            soft_wrap=True,
        )

    def underway(self, worker: int, what: str, done: int, total: int) -> None:
        if not total:
            return
        if worker not in self._workers:
            self._workers[worker] = self._bar.add_task(f"process {worker + 1}", note="")
        self._bar.update(self._workers[worker], completed=done, total=total, note=what)


def print_summary(outcome: StudyOutcome, values: dict[str, Any]) -> None:
    """The verdict and the best designs, on standard output."""
    from rich.table import Table
    from rich.text import Text

    from taccel_lab.cli.console import results
    from taccel_lab.report.page import format_number

    console = results()
    verdict = values["verdict"]
    console.print(Text(verdict["headline"], style="green" if verdict["good"] else "yellow"))
    for sentence in verdict["sentences"]:
        console.print(Text(f"- {sentence}"))
    if not values["best"]:
        return
    rows = {row.id: row for row in outcome.rows}
    best = [rows[design_id] for design_id in values["best"]]
    table = Table(title=f"best designs: {values['goal']}", title_justify="left")
    table.add_column("figure", style="cyan", no_wrap=True)
    table.add_column("unit")
    for row in best:
        table.add_column(values["names"][row.id], justify="right")
    last = {kind: list(values[kind])[-1] for kind in ("parameters", "metrics")}
    for kind in last:
        for name, item in values[kind].items():
            cells = [{**row.parameters, **row.figures}[name] for row in best]
            unit = "" if item["unit"] == "1" else item["unit"]
            table.add_row(
                Text(name), unit, *map(format_number, cells), end_section=name == last[kind]
            )
    console.print(table)
