# SPDX-License-Identifier: Apache-2.0
"""The picture of a run: where each seed began, and its headline figure."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.report.style import BLUE, ORANGE, in_report_style, new_figure, save_figure
from taccel_lab.tasks.figure_label import figure_label
from taccel_lab.tasks.result import TaskResult, success_interval


@in_report_style
def draw_result(result: TaskResult, headline: str, path: Path) -> None:
    """Starts of the seeds and the figure ``headline`` of each into a PNG file."""
    trials = result.trials
    good = np.array([trial.success for trial in trials])
    figure, (left, right) = new_figure(9.6, 4.0, 1, 2)
    axes = list(trials[0].start)[:2]
    starts = np.array([[trial.start[name] for name in axes] for trial in trials])
    values = np.array([trial.figures.get(headline, np.nan) for trial in trials])
    kinds = ((good, "o", BLUE, "success"), (~good, "x", ORANGE, "failure"))
    for chosen, marker, color, label in kinds:
        named = f"{label} ({int(chosen.sum())})"
        across = starts[chosen, 1] if len(axes) > 1 else np.zeros(int(chosen.sum()))
        left.scatter(starts[chosen, 0], across, marker=marker, color=color, label=named)
        seeds = [t.seed for t, c in zip(trials, chosen, strict=True) if c]
        right.scatter(seeds, values[chosen], marker=marker, color=color)
    left.set_xlabel(f"start {figure_label(axes[0])}")
    left.set_ylabel(f"start {figure_label(axes[1])}" if len(axes) > 1 else "")
    rate, low, high = success_interval(result.successes, len(trials))
    left.set_title(f"{result.task}: {rate:.1%} (95 %: {low:.1%} to {high:.1%})")
    left.legend(loc="best", frameon=True)
    right.set_xlabel("seed")
    right.set_ylabel(figure_label(headline))
    save_figure(figure, path)
