# SPDX-License-Identifier: Apache-2.0
"""Success of each cell of a run with several, as a table in colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.report.style import in_report_style, new_figure, save_figure
from taccel_lab.tasks.result import TaskResult, success_interval


@in_report_style
def draw_cells(result: TaskResult, path: Path) -> None:
    """Successes of cells of two names, row and column, into a PNG file."""
    cells = {(entry["cell"][0], entry["cell"][1]): entry for entry in result.cells()}
    rows, columns = (list(dict.fromkeys(name[i] for name in cells)) for i in range(2))
    rates = np.full((len(rows), len(columns)), np.nan)
    figure, axes = new_figure(1.6 + 0.78 * len(columns), 1.9 + 0.52 * len(rows))
    for (row, column), entry in cells.items():
        i, j = rows.index(row), columns.index(column)
        rates[i, j] = entry["success_rate"]
        low, high = (100 * bound for bound in entry["interval_95"])
        text = f"{entry['successes']} of {entry['trials']}\n{low:.0f}-{high:.0f} %"
        color = "white" if rates[i, j] > 0.6 else "black"
        axes.text(j, i, text, ha="center", va="center", color=color, fontsize=7)
    axes.imshow(rates, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    axes.set_xticks(range(len(columns)), columns, rotation=35, ha="right")
    axes.set_yticks(range(len(rows)), rows)
    axes.grid(visible=False)
    rate, low, high = success_interval(result.successes, len(result.trials))
    axes.set_title(
        f"{result.task}: {result.successes} of {len(result.trials)}, {rate:.1%} "
        f"(95 %: {low:.1%} to {high:.1%})"
    )
    save_figure(figure, path)
