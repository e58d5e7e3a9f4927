# SPDX-License-Identifier: Apache-2.0
"""Pictures of a live reading, drawn fast: no axes, one colour scale with its numbers a map."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import cv2
import numpy as np

from taccel_lab.calibration.live.reader import LiveReading
from taccel_lab.calibration.pressure.contact_pressure import ContactPressure

if TYPE_CHECKING:
    from viser import GuiApi

LEAST_DEEPEST_MM = 0.3
"""The colour scale of the depth ends here at least, so that noise stays dark."""
BEYOND = (225, 60, 160)
"""Pixels beyond the calibration."""
REFUSED = (170, 170, 170)
LEAST_PRESSURE_PA = 1e4
"""The colour scale of the pressure ends here at least."""
PAPER, INK = 250, (60, 60, 60)
ARROWS = 3.0
"""Times the markers' displacement."""


def pictures(reading: LiveReading, background: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Title and RGB uint8 picture of all that was read."""
    change = reading.image.astype(np.int16) - background.astype(np.int16)
    shown = [
        ("camera", reading.image),
        ("change", np.clip(128 + 2 * change, 0, 255).astype(np.uint8)),
    ]
    if reading.surface is not None:
        shown += [depth_picture(reading), ("normals", _normals(reading.surface.normals))]
        if reading.press is not None:
            shown.append(pressure_picture(reading.press))
    if reading.markers_px is not None:
        shown.append((f"markers, arrows x{ARROWS:g}", _markers(reading)))
    return shown


def depth_picture(reading: LiveReading) -> tuple[str, np.ndarray]:
    """Title with the scale, and the depth in colours; what the calibration does not reach is
    marked, and a depth that is rejected is grey."""
    surface = reading.surface
    assert surface is not None
    depth_mm = -1e3 * surface.rise_m
    deepest = max(float(depth_mm.max()), LEAST_DEEPEST_MM)
    levels = np.clip(255 * depth_mm / deepest, 0, 255).astype(np.uint8)
    picture = _colored(levels, cv2.COLORMAP_VIRIDIS)
    for marked in (surface.beyond_balls, surface.saturated):
        if marked is not None:
            picture[marked] = BEYOND
    if reading.refused:
        picture[:] = REFUSED
        return "depth: rejected", picture
    title = "depth [mm] (pink: beyond the calibration)"
    return title, _with_bar(picture, cv2.COLORMAP_VIRIDIS, deepest)


def pressure_picture(press: ContactPressure) -> tuple[str, np.ndarray]:
    """Title and the contact pressure in colours."""
    peak = max(float(press.pressure_pa.max()), LEAST_PRESSURE_PA)
    levels = np.clip(255 * press.pressure_pa / peak, 0, 255).astype(np.uint8)
    picture = _colored(levels, cv2.COLORMAP_INFERNO)
    return "pressure [kPa]", _with_bar(picture, cv2.COLORMAP_INFERNO, 1e-3 * peak)


def _colored(levels: np.ndarray, colors: int) -> np.ndarray:
    return cv2.cvtColor(cv2.applyColorMap(levels, colors), cv2.COLOR_BGR2RGB)


def _with_bar(picture: np.ndarray, colors: int, high: float) -> np.ndarray:
    """The picture with its colour bar from 0 to ``high`` on the right."""
    height = picture.shape[0]
    text = max(0.3, height / 600)
    wide = max(6, height // 24)
    bar = np.full((height, wide + round(110 * text), 3), PAPER, np.uint8)
    levels = np.linspace(255, 0, height).astype(np.uint8)[:, None]
    bar[:, 2 : 2 + wide] = _colored(np.repeat(levels, wide, axis=1), colors)
    digits = 0 if high >= 20 else 2
    for share in (0.0, 0.5, 1.0):
        row = round((1 - share) * (height - 1))
        where = (wide + 6, min(max(row + round(10 * text), round(24 * text)), height - 2))
        label = f"{share * high:.{digits}f}"
        cv2.putText(bar, label, where, cv2.FONT_HERSHEY_SIMPLEX, text, INK, 1, cv2.LINE_AA)
    return np.hstack([picture, bar])


def _normals(normals: np.ndarray) -> np.ndarray:
    return np.clip(127.5 * (normals + 1.0), 0, 255).astype(np.uint8)


def _markers(reading: LiveReading) -> np.ndarray:
    picture = reading.image.copy()
    assert reading.markers_px is not None
    assert reading.rest_px is not None
    assert reading.seen is not None
    for place, rest, seen in zip(reading.markers_px, reading.rest_px, reading.seen, strict=True):
        if not np.isfinite(place).all():
            continue
        tip = rest + ARROWS * (place - rest)
        color = (255, 220, 0) if seen else (160, 160, 160)
        ends = [(round(float(u)), round(float(v))) for u, v in (rest, tip)]
        cv2.arrowedLine(picture, ends[0], ends[1], color, 1, cv2.LINE_AA, tipLength=0.3)
    return picture


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
