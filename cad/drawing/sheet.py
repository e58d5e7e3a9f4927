# SPDX-License-Identifier: Apache-2.0
"""A sheet of paper in millimetres: lines, hatched sections, dimension lines, title block.

Drawn with matplotlib, so that SVG, PDF and PNG come from the same geometry. Equal input gives equal
files: nothing on the sheet depends on date or chance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Polygon, Rectangle
from matplotlib.path import Path as Curve

from taccel_lab.files.atomic_file import write_by

Xy = tuple[float, float]

THICK, THIN = 0.5, 0.25
"""Line widths [mm] of visible edges and of everything else, ISO 128."""
TEXT_MM = 3.2
_ARROW_MM, _ARROW_WIDTH_MM = 2.6, 0.9
_GAP_MM, _OVERSHOOT_MM = 0.8, 1.5
_POINTS = 72 / 25.4
_DASHES = {"hidden": (0, (7, 4)), "axis": (0, (18, 4, 3, 4))}
_INK, _DIM = "black", "#1f3a5f"
_SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "taccel_lab",
    "svg.fonttype": "none",
    "hatch.linewidth": 0.4,
}


class DrawingSheet:
    """A landscape sheet; x to the right and y up from its lower left corner [mm]."""

    def __init__(self, width_mm: float, height_mm: float) -> None:
        self.width_mm, self.height_mm = width_mm, height_mm
        self._figure = Figure(figsize=(width_mm / 25.4, height_mm / 25.4))
        self._canvas = FigureCanvasAgg(self._figure)
        self._axes = self._figure.add_axes((0, 0, 1, 1))
        self._axes.set(xlim=(0, width_mm), ylim=(0, height_mm))
        self._axes.axis("off")
        self.box(8, 8, width_mm - 16, height_mm - 16, THICK)

    def line(
        self, points: Sequence[Xy] | np.ndarray, width: float = THIN, style: str = "", color=_INK
    ) -> None:
        """A polyline; styles: "" for solid, "hidden" for dashed, "axis" for dash-dotted."""
        xy = np.asarray(points, dtype=float)
        self._axes.plot(
            xy[:, 0], xy[:, 1], color=color, linewidth=width * _POINTS,
            linestyle=_DASHES.get(style, "-"), solid_capstyle="round", solid_joinstyle="round",
        )  # fmt: skip

    def box(self, x: float, y: float, width: float, height: float, line: float = THIN) -> None:
        """An empty rectangle."""
        self._axes.add_patch(
            Rectangle((x, y), width, height, fill=False, linewidth=line * _POINTS, edgecolor=_INK)
        )

    def area(
        self, loops: Sequence[np.ndarray], *, fill: str = "white", hatch: str = "", width=THICK,
        edge: str = _INK,
    ) -> None:  # fmt: skip
        """A cut face bounded by closed loops, the first outside and holes after it."""
        codes, points = [], []
        for loop in loops:
            closed = np.concatenate([loop, loop[:1]])
            points.append(closed)
            codes += [Curve.MOVETO, *[Curve.LINETO] * (len(loop) - 1), Curve.CLOSEPOLY]
        curve = Curve(np.concatenate(points), codes)
        self._axes.add_patch(PathPatch(curve, facecolor=fill, edgecolor="none"))
        if hatch:
            self._axes.add_patch(
                PathPatch(curve, facecolor="none", edgecolor="#8a8f98", hatch=hatch, linewidth=0)
            )
        self._axes.add_patch(
            PathPatch(curve, facecolor="none", edgecolor=edge, linewidth=width * _POINTS)
        )

    def text(
        self, at: Xy, words: str, *, size: float = TEXT_MM, align: str = "left", angle: float = 0,
        bold: bool = False, color: str = _INK, clear: bool = False, vertical: str = "center",
    ) -> None:  # fmt: skip
        """Words on the sheet; ``clear`` wipes what lies under them."""
        self._axes.text(
            *at, words, fontsize=size * _POINTS, ha=align, va=vertical, rotation=angle,
            color=color, fontweight="bold" if bold else "normal",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0} if clear else None,
        )  # fmt: skip

    def dimension(self, start: Xy, end: Xy, offset: float, words: str, *, along: str = "") -> None:
        """A dimension line between two points, ``offset`` mm to the left of start -> end.

        ``along`` = "x" or "y" measures that coordinate only; then the offset counts upwards or
        to the left.
        """
        a, b = np.array(start, dtype=float), np.array(end, dtype=float)
        if along:
            axis = 0 if along == "x" else 1
            direction = np.eye(2)[axis] * (1 if b[axis] >= a[axis] else -1)
            normal = np.array([0.0, 1.0]) if along == "x" else np.array([-1.0, 0.0])
            level = (np.max if offset > 0 else np.min)([a @ normal, b @ normal]) + offset
        else:
            direction = (b - a) / np.linalg.norm(b - a)
            normal = np.array([-direction[1], direction[0]])
            level = a @ normal + offset
        feet = [point + (level - point @ normal) * normal for point in (a, b)]
        side = math.copysign(1.0, offset)
        for point, foot in zip((a, b), feet, strict=True):
            if np.linalg.norm(foot - point) > _GAP_MM:
                reach = np.stack(
                    [point + side * _GAP_MM * normal, foot + side * _OVERSHOOT_MM * normal]
                )
                self.line(reach, THIN / 1.5, color=_DIM)
        self._dimension_line(feet[0], feet[1], direction, normal, words)

    def _dimension_line(
        self, a: np.ndarray, b: np.ndarray, direction: np.ndarray, normal: np.ndarray, words: str
    ) -> None:
        length = float((b - a) @ direction)
        width = 0.62 * TEXT_MM * len(words)
        angle = math.degrees(math.atan2(direction[1], direction[0]))
        # Read from below or from the right.
        angle = (angle + 90) % 180 - 90
        if abs(angle + 90) < 1e-6:
            angle = 90.0
        up = np.array([-math.sin(math.radians(angle)), math.cos(math.radians(angle))])
        inside = length > width + 2 * _ARROW_MM + 1
        arrows_inside = length > 3 * _ARROW_MM
        outward = 0.0 if arrows_inside else 2.2 * _ARROW_MM
        self.line(
            np.stack([a - outward * direction, b + outward * direction]), THIN / 1.5, color=_DIM
        )
        sign = 1 if arrows_inside else -1
        self._arrow(a, -sign * direction)
        self._arrow(b, sign * direction)
        lift = up * (0.62 * TEXT_MM + 0.3)
        if inside:
            self.text(tuple((a + b) / 2 + lift), words, angle=angle, align="center", color=_DIM)
            return
        end = b + direction * (max(outward, 1.0) + width / 2 + 0.8)
        if arrows_inside or outward:
            shelf = np.stack([b, b + direction * (max(outward, 1.0) + width + 0.8)])
            self.line(shelf, THIN / 1.5, color=_DIM)
        self.text(tuple(end + lift), words, angle=angle, align="center", color=_DIM)

    def leader(self, point: Xy, elbow: Xy, words: str) -> None:
        """An arrow to ``point`` from words at ``elbow``, on a shelf that leads away from it."""
        side = 1 if elbow[0] >= point[0] else -1
        width = max(0.62 * TEXT_MM * len(line) for line in words.split("\n"))
        shelf = (elbow[0] + side * (width + 1), elbow[1])
        self.line([point, elbow, shelf], THIN / 1.5, color=_DIM)
        arrow = np.array(point) - np.array(elbow)
        self._arrow(np.array(point), arrow / np.linalg.norm(arrow))
        middle = (elbow[0] + side * (width + 1) / 2, elbow[1] + 0.8)
        self.text(middle, words, align="center", color=_DIM, vertical="bottom")

    def _arrow(self, tip: np.ndarray, direction: np.ndarray) -> None:
        normal = np.array([-direction[1], direction[0]])
        back = tip - _ARROW_MM * direction
        corners = [tip, back + _ARROW_WIDTH_MM / 2 * normal, back - _ARROW_WIDTH_MM / 2 * normal]
        self._axes.add_patch(Polygon(corners, closed=True, facecolor=_DIM, edgecolor="none"))

    def picture(self, width_px: int) -> np.ndarray:
        """The sheet as an image of a width, uint8 [height, width, 3]."""
        self._figure.set_dpi(width_px / self.width_mm * 25.4)
        with mpl.rc_context(_SETTINGS):
            self._canvas.draw()
        return np.array(self._canvas.buffer_rgba())[..., :3]

    def save(self, *paths: Path) -> None:
        """Write SVG, PDF or PNG files, by their suffixes."""
        for path in paths:
            suffix = path.suffix.lstrip(".")
            metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}[suffix]
            draw = partial(self._figure.savefig, format=suffix, dpi=110, metadata=metadata)
            with mpl.rc_context(_SETTINGS):
                write_by(path, draw)
