# SPDX-License-Identifier: Apache-2.0
"""Predicted against true parts, as a table in colours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from taccel_lab.report.style import in_report_style, new_figure, save_figure


@in_report_style
def draw_confusion(pairs: Sequence[tuple[int, int]], names: Sequence[str], path: Path) -> None:
    """Pairs of what a part is and what it was taken for into a PNG file."""
    counts = np.zeros((len(names), len(names)), dtype=int)
    np.add.at(counts, tuple(np.array(pairs).T), 1)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    figure, axes = new_figure(6.4, 5.6)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1)
    for (row, column), number in np.ndenumerate(counts):
        if number:
            color = "white" if shares[row, column] > 0.5 else "black"
            axes.text(column, row, str(number), ha="center", va="center", color=color)
    axes.set_xticks(range(len(names)), names, rotation=40, ha="right")
    axes.set_yticks(range(len(names)), names)
    axes.set(xlabel="taken for", ylabel="part")
    axes.grid(visible=False)
    right, total = int(np.trace(counts)), int(counts.sum())
    axes.set_title(f"{right} of {total} grasps classified correctly, {right / total:.1%}")
    save_figure(figure, path)
