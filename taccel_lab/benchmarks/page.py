# SPDX-License-Identifier: Apache-2.0
"""A result file of a suite as a page: what was measured, on which machine, a table of its rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from taccel_lab.report.html import format_number
from taccel_lab.report.page import Page, Table, sentence

SIDE_BY_SIDE = 5
"""Rows that stand beside one another, a line for each of their figures; more stand one below the
other."""
COLUMNS = 6
"""Of a table of many rows, which goes on in another."""


def benchmark_page(document: dict[str, Any]) -> Page:
    """The page of a result file (``read_result``)."""
    rows = [dict(flat(row)) for row in document["rows"]]
    state = "all rows" if document["complete"] else "not complete"
    seconds = format_number(document["seconds"])
    own = ("schema", "suite", "what", "run", "settings", "complete", "rows", "seconds")
    beside = dict(flat({k: v for k, v in document.items() if k not in own}))
    return Page(
        title=f"Benchmark {document['suite']}",
        summary=f"{sentence(document['what'])} Measured in {seconds} s, {state}.",
        headline=_headline(rows),
        tables=[
            *(
                [Table("Figures of the whole", ("figure", "value"), list(beside.items()))]
                * bool(beside)
            ),
            *_tables(rows),
            Table("Settings", ("setting", "value"), list(flat(document["settings"])), folded=True),
            Table("Machine", ("figure", "value"), list(flat(document["run"])), folded=True),
        ],
    )


def _headline(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many goals were met, where there are any."""
    met = [row["met"] for row in rows if "met" in row]
    return f"{sum(map(bool, met))} of {len(met)} goals met" if met else f"{len(rows)} rows"


def _tables(rows: list[dict[str, Any]]) -> Iterator[Table]:
    """Rows side by side where they are few, otherwise as many columns at a time as a page takes."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    if not names:
        return
    if len(rows) <= SIDE_BY_SIDE:
        first, *others = names
        columns = ["figure", *(str(row.get(first, number)) for number, row in enumerate(rows, 1))]
        yield Table("Rows", columns, [[n, *(row.get(n) for row in rows)] for n in others])
        return
    first, others = names[0], names[1:]
    for start in range(0, len(others), COLUMNS):
        part = [first, *others[start : start + COLUMNS]]
        cells = [[row.get(name) for name in part] for row in rows]
        yield Table(
            "Rows" if start == 0 else "Rows, further figures", part, cells, folded=start > 0
        )


def flat(table: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Figures by their names, those of inner tables after the table's."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from flat(value, f"{before}{name}: ")
        elif isinstance(value, bool):
            yield before + name, "yes" if value else "no"
        elif isinstance(value, (list, tuple)):
            yield before + name, ", ".join(map(str, value))
        else:
            yield before + name, value
