# SPDX-License-Identifier: Apache-2.0
"""Depth, contact area and force of the last seconds, as curves that run along."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.live.reader import LiveReading

if TYPE_CHECKING:
    from viser import GuiApi

SECONDS = 30.0
MOST_POINTS = 600
CURVES = (
    ("depth [mm]", "max_depth_mm", "#1f77b4"),
    ("contact [mm²]", "contact_mm2", "#2ca02c"),
    ("normal force [N]", "force_n", "#d62728"),
)
"""Label, figure of the reading, colour."""


class StripChart:
    """Three curves over one time."""

    def __init__(self, gui: GuiApi) -> None:
        """Put the chart below what the page has so far."""
        from viser import uplot

        self._rows: deque[tuple[float, ...]] = deque()
        empty = np.zeros(1), np.zeros(1)
        self._plots = [
            gui.add_uplot(
                data=empty,
                series=(uplot.Series(label="s"), uplot.Series(label=label, stroke=color, width=2)),
                scales={"x": uplot.Scale(time=False)},
                title=label,
                aspect=3.5,
            )
            for label, _, color in CURVES
        ]

    def add(self, now_s: float, reading: LiveReading) -> None:
        """Take a reading in; what it does not tell, or what is rejected, is a gap."""
        figures = {} if reading.refused else reading.figures
        values = (float(figures.get(name, np.nan)) for _, name, _ in CURVES)
        self._rows.append((now_s, *values))
        while now_s - self._rows[0][0] > SECONDS:
            self._rows.popleft()

    def draw(self) -> None:
        """Show what was taken in."""
        rows = np.array(list(self._rows)[:: 1 + len(self._rows) // MOST_POINTS])
        past_s = rows[:, 0] - rows[-1, 0]
        for plot, values in zip(self._plots, rows.T[1:], strict=True):
            plot.data = past_s, values
