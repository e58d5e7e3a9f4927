# SPDX-License-Identifier: Apache-2.0
"""Generated parts of the pages about calibration on captures, in Markdown."""

from __future__ import annotations

from collections.abc import Iterator

from taccel_lab.benchmarks.report.figures import Document, number
from taccel_lab.report.markdown import markdown_table


def captures(document: Document) -> Iterator[str]:
    """Calibrations of published captures against their goals."""
    rows = [
        [
            row["set"],
            f"`{row['command']}`",
            row["figure"],
            number(row["value"]),
            f"{'at least' if row['at_least'] else 'at most'} {row['goal']:g}",
            "met" if row["met"] else "**missed**",
            row["verdict"] or "-",
            "-" if row["fit_seconds"] is None else number(row["fit_seconds"], 2),
            number(row["seconds"], 3),
        ]
        for row in document["rows"]
    ]
    head = ["captures", "calibration", "figure", "value", "goal", "", "verdict", "fit [s]"]
    yield markdown_table([*head, "command [s]"], rows)


def check_errors(document: Document) -> Iterator[str]:
    """Named presses of all, good and spoiled, a row a fault and a column a set."""
    rows = document["rows"]
    sets = list(dict.fromkeys(row["set"] for row in rows))
    cases = dict.fromkeys((row["case"], row.get("code", "any of those below")) for row in rows)
    counts = {(row["case"], row["set"]): f"{row['named']} of {row['count']}" for row in rows}
    yield markdown_table(
        ["presses", "named by", *sets],
        [
            [case, f"`{code}`" if "_" in code or code.isalpha() else code]
            + [counts.get((case, name), "-") for name in sets]
            for case, code in cases
        ],
    )
