# SPDX-License-Identifier: Apache-2.0
"""Metrics and standard presses in words, and the tables of docs/studies.md made from them.

``python -m taccel_lab.studies.describe docs/studies.md`` brings the tables of the page up to date.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable
from pathlib import Path

from taccel_lab.studies.presses import StandardPress


def press_in_words(press: StandardPress) -> str:
    """Indenters, depth, motion and places of a press, in one line."""
    parts = [" / ".join(press.indenters)]
    if press.depth_mm:
        parts.append(f"{press.depth_mm:g} mm deep")
    else:
        most = press.depth_limit_mm
        limit = f", at most {most:g} mm" if math.isfinite(most) else ""
        parts.append(f"{press.depth_fraction:.0%} of the gel's thickness deep{limit}")
    if press.shear_fraction:
        back = " and back" if press.shear_back else ""
        parts.append(f"sideways by {press.shear_fraction:g} of the depth{back}")
    if press.twist_deg:
        parts.append(f"turned by {press.twist_deg:g} deg")
    if press.release:
        parts.append("up again")
    if len(press.places) > 1:
        parts.append(f"in {len(press.places)} places")
    return "; ".join([*parts, f"{len(press.waypoints())} steps"])


def metrics_table() -> str:
    """All metrics as a Markdown table."""
    from taccel_lab.studies.metrics import METRICS

    lines = ["| metric | unit | better | read from | what it is |", "|---|---|---|---|---|"]
    for name, metric in METRICS.items():
        read = ", ".join(metric.presses) or "no press"
        unit = metric.unit if metric.unit != "1" else "–"
        better = metric.better if metric.better != "none" else "–"
        lines.append(f"| `{name}` | {unit} | {better} | {read} | {metric.description} |")
    return "\n".join(lines)


def presses_table() -> str:
    """All standard presses as a Markdown table."""
    from taccel_lab.studies.presses import STANDARD_PRESSES

    lines = ["| press | what it does |", "|---|---|"]
    lines += [f"| `{name}` | {press_in_words(p)} |" for name, p in STANDARD_PRESSES.items()]
    return "\n".join(lines)


TABLES: dict[str, Callable[[], str]] = {"metrics": metrics_table, "presses": presses_table}


def with_tables(page: str) -> str:
    """A Markdown page with the tables between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``."""
    for name, table in TABLES.items():
        begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
        between = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
        if len(between.findall(page)) != 1:
            raise ValueError(f"the page needs one {begin} followed by {end}")
        text = f"{begin}\n{table()}\n{end}"
        page = between.sub(lambda _, text=text: text, page)
    return page


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")
