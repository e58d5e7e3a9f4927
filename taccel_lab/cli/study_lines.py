# SPDX-License-Identifier: Apache-2.0
"""What ``taccel-lab study`` says: a line a design while it runs, at the end all designs."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.studies.evaluate.design_row import DesignRow
    from taccel_lab.studies.evaluate.runner import StudyOutcome
    from taccel_lab.studies.spec.study import Study

SHOWN = 40
"""Most designs of the table at the end."""
_MOST_METRICS = 4
"""Most metrics of that table, the first ones that the study names."""
_NOTE, _BETWEEN = 20, 2
"""Characters that a note needs, and those between two columns."""


class StudyProgress:
    """A ``Listener`` that shows a bar over the designs with the time left and the failures, and a
    line a process."""

    def __init__(self, console: Console, study: Study) -> None:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

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
        self._begun = time.monotonic()

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
        if there:
            self._bar.console.print(f"{there} of {total} designs are there already, {to_do} to do")
        self._total, self._begun = to_do, time.monotonic()
        self._task = self._bar.add_task("designs", total=to_do, note="")

    def finished(self, design: DesignRow) -> None:
        self._lost += design.status != "done"
        self._done += 1
        spent = time.monotonic() - self._begun
        left = spent * (self._total - self._done) / self._done
        name = self._study.name_of(design.parameters)
        failed = f", {self._lost} failed" if self._lost else ""
        self._bar.console.print(
            f"{self._done} of {self._total} designs{failed}: {name}: {self._said(design)}; "
            f"{spent:.0f} s spent, about {left:.0f} s left",
            soft_wrap=True,
        )
        self._bar.update(self._task, advance=1, note=failed.removeprefix(", "))

    def _said(self, design: DesignRow) -> str:
        """The figure that ranks designs, or the first one, or why there is none."""
        from taccel_lab.report.page import format_number

        goals = [goal.metric for goal in self._study.spec.goals]
        name = next(iter([*goals, *self._study.metrics]))
        metric = self._study.metrics[name]
        value = design.figures.get(name)
        if design.status != "done" or value is None:
            why = design.cause if design.status != "done" else design.causes.get(name, "no value")
            return f"{design.status}, {why}"
        return f"{name} {format_number(value)} {metric.unit if metric.unit != '1' else ''}".strip()

    def underway(self, worker: int, what: str, done: int, total: int) -> None:
        if not total:
            return
        if worker not in self._workers:
            self._workers[worker] = self._bar.add_task(f"process {worker + 1}", note="")
        self._bar.update(self._workers[worker], completed=done, total=total, note=what)


def print_summary(outcome: StudyOutcome, values: dict[str, Any]) -> None:
    """The verdict, and all designs by the metric that the study names, on standard output."""
    from taccel_lab.cli.console import print_table, results
    from taccel_lab.studies.evaluate.study_folder import CSV_NAME

    console = results()
    verdict = values["verdict"]
    console.print(verdict["headline"], style="green" if verdict["good"] else "yellow")
    for sentence in verdict["sentences"]:
        console.print(f"- {sentence}")
    if not outcome.rows:
        return
    metrics = list(outcome.study.metrics)[:_MOST_METRICS]
    goal = values["goal_metric"]
    if goal is not None:
        metrics = [goal, *(name for name in metrics if name != goal)][:_MOST_METRICS]
    ordered = _ordered(outcome, goal)
    names = [values["names"][row.id] for row in ordered[:SHOWN]]
    metrics = _fitting(metrics, console.width - max(map(len, names)))
    units = {name: outcome.study.metrics[name].unit for name in metrics}
    columns = [name if units[name] == "1" else f"{name}\n[{units[name]}]" for name in metrics]
    rows = [
        (name, *_cells(outcome, row, metrics)) for name, row in zip(names, ordered, strict=False)
    ]
    by = f"all designs: {values['goal']}" if goal else "all designs"
    print_table(("design", *columns, "note"), rows, by)
    if len(ordered) > SHOWN:
        console.print(f"and {len(ordered) - SHOWN} more in {CSV_NAME}")


def _fitting(metrics: list[str], room: int) -> list[str]:
    """The first metrics whose names fit into so many characters beside a note, at least one: names
    that a table breaks between any two letters say nothing."""
    room -= _NOTE
    kept = 0
    for name in metrics:
        room -= len(name) + _BETWEEN
        kept += room >= 0
    return metrics[: max(1, kept)]


def _ordered(outcome: StudyOutcome, goal: str | None) -> list[DesignRow]:
    """Designs within the constraints, the best first; then the others by the same metric; then
    those without that figure."""
    from taccel_lab.studies.evaluate.design_row import directed, is_feasible

    spec = outcome.study.spec
    if goal is None:
        return outcome.rows
    objective = directed(spec.goals, outcome.study.metrics)[0]
    return sorted(
        outcome.rows,
        key=lambda row: (
            row.figures.get(goal) is None,
            not is_feasible(row, spec.constraints),
            objective.cost(row.figures),
        ),
    )


def _cells(outcome: StudyOutcome, row: DesignRow, metrics: list[str]) -> list[str]:
    """Figures of a design, and what is to be said of it."""
    from taccel_lab.report.page import format_number
    from taccel_lab.studies.evaluate.design_row import violations

    cells = [
        "-" if (value := row.figures.get(name)) is None else format_number(value)
        for name in metrics
    ]
    if row.status != "done":
        return [*cells, f"{row.status}: {row.cause}"]
    missed = violations(row, outcome.study.spec.constraints)
    return [*cells, f"misses {', '.join(missed)}" if missed else ""]
