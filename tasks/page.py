# SPDX-License-Identifier: Apache-2.0
"""A run of a task as a page: how many seeds succeeded, what was measured, why others failed."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.report.page import Page, Picture, Table, sentence
from taccel_lab.tasks.figure_label import figure_label

if TYPE_CHECKING:
    from taccel_lab.tasks.catalogue import Task
    from taccel_lab.tasks.result import TaskResult

CAPTIONS = {
    "seeds": "Where each seed began, and its headline figure.",
    "cells": "Share of seeds that succeed, by cell.",
    "confusion": "Predicted against true parts.",
}
"""Of pictures by their names."""
MOST_SEEDS = 400
"""Rows of the page; result.json has all."""


def task_page(task: Task, result: TaskResult, run: dict[str, Any], folder: Path) -> Page:
    """The page of a run on the machine ``run``, with the pictures that lie in ``folder``."""
    table = result.table()
    low, high = table["interval_95"]
    stopped = "" if table["trials"] == table["asked"] else f" Interrupted: of {table['asked']}."
    return Page(
        title=f"Task {task.name}",
        summary=f"{sentence(task.parameters.summary)} Success: "
        f"{task.parameters.criterion}.{stopped}",
        headline=f"{table['successes']} of {table['trials']} seeds succeed: "
        f"{table['success_rate']:.1%} (95 %: {low:.1%} to {high:.1%})",
        tables=[
            *_cells(table),
            Table("Figures", ("figure", "median", "5 %", "95 %"), _figures(table)),
            *_causes(result),
            Table("Seeds", *_seeds(table["per_seed"]), folded=True),
            Table("Settings", ("setting", "value"), _settings(task), folded=True),
            Table("Machine", ("figure", "value"), _rows(run), folded=True),
        ],
        pictures=[
            Picture(path.stem, path.read_bytes, CAPTIONS.get(path.stem, path.name))
            for path in sorted(folder.glob("*.png"))
        ],
    )


def _figures(table: dict[str, Any]) -> list[tuple[Any, ...]]:
    return [
        (figure_label(name), spread["median"], spread["p05"], spread["p95"])
        for name, spread in table["figures"].items()
        if spread
    ]


def _cells(table: dict[str, Any]) -> list[Table]:
    rows = [
        (
            ", ".join(cell["cell"]), cell["successes"], cell["trials"],
            "{:.0%} to {:.0%}".format(*cell["interval_95"]),
            ", ".join(f"{cause} ({count})" for cause, count in cell["causes"].items()),
        )
        for cell in table.get("cells", ())
    ]  # fmt: skip
    columns = ("cell", "successes", "seeds", "95 % interval", "why others failed")
    return [Table("Cells", columns, rows)] if rows else []


def _causes(result: TaskResult) -> list[Table]:
    # Numbers differ from seed to seed: "came 0.7 mm deep" and "came 1.4 mm deep" are one cause.
    causes = (
        re.sub(r"-?\d+(?:\.\d+)?", "…", trial.cause) for trial in result.trials if trial.cause
    )
    counts = Counter(causes)
    if not counts:
        return []
    return [Table("Why seeds failed", ("cause", "seeds"), counts.most_common())]


def _seeds(rows: list[dict[str, Any]]) -> tuple[tuple[str, ...], list[list[Any]], str]:
    shown = rows[:MOST_SEEDS]
    names = tuple(dict.fromkeys(name for row in shown for name in row))
    cells = [[_text(row.get(name)) for name in names] for row in shown]
    return (
        tuple(map(figure_label, names)),
        cells,
        "" if len(shown) == len(rows) else f"The first {len(shown)}.",
    )


def _settings(task: Task) -> list[tuple[str, Any]]:
    return _rows(task.parameters.model_dump(mode="json"))


def _rows(table: dict[str, Any]) -> list[tuple[str, Any]]:
    return [(name, _text(value)) for name, value in table.items() if value not in ("", None)]


def _text(value: Any) -> Any:
    """What a cell takes of a JSON value."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{name}: {_text(inner)}" for name, inner in value.items())
    return ", ".join(map(str, map(_text, value))) if isinstance(value, (list, tuple)) else value
