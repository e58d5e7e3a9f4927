# SPDX-License-Identifier: Apache-2.0
"""Metrics and standard presses in words, and the tables of docs/studies.md made from them.

``python -m taccel_lab.studies.report.describe docs/studies.md`` brings its tables up to date.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from taccel_lab.report.markdown import markdown_table, with_parts
from taccel_lab.studies.presses.standard import StandardPress
from taccel_lab.studies.spec.readings import described


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

    head = ["metric", "unit", "better", "read from", "meaning"]
    rows = [
        [
            f"`{name}`",
            metric.unit if metric.unit != "1" else "–",
            metric.better if metric.better != "none" else "–",
            " or ".join([", ".join(metric.presses) or "no press", *metric.also]),
            described(metric).description,
        ]
        for name, metric in METRICS.items()
    ]
    return markdown_table(head, rows)


def presses_table() -> str:
    """All standard presses as a Markdown table."""
    from taccel_lab.studies.presses.standard import STANDARD_PRESSES

    rows = [[f"`{name}`", press_in_words(press)] for name, press in STANDARD_PRESSES.items()]
    return markdown_table(["press", "what it does"], rows)


def with_tables(page: str) -> str:
    """docs/studies.md with its tables made anew."""
    return with_parts(page, {"metrics": metrics_table(), "presses": presses_table()})


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")
