# SPDX-License-Identifier: Apache-2.0
"""Where on the image contacts were, by pixel and by the cells of a 4 x 3 table, and which press is
missing most."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.geometry import PixelGrid

CELLS = (4, 3)
"""Columns and rows of the coverage table."""
_COLUMNS, _ROWS = ("left", "left centre", "right centre", "right"), ("top", "middle", "bottom")
_CELLS = [(column, row) for row in range(CELLS[1]) for column in range(CELLS[0])]


def coverage_map(circles: Sequence[ContactCircle], grid: PixelGrid) -> np.ndarray:
    """How many contacts touched each pixel, int, shape [height_px, width_px]."""
    count = np.zeros((grid.height_px, grid.width_px), dtype=np.int32)
    for circle in circles:
        count += circle.distance_px(grid) <= circle.radius_px
    return count


def cell_of(circle: ContactCircle, width_px: int, height_px: int) -> tuple[int, int]:
    """Column and row of the cell in which the centre of a contact lies."""
    column = min(int(circle.u_px / width_px * CELLS[0]), CELLS[0] - 1)
    return column, min(int(circle.v_px / height_px * CELLS[1]), CELLS[1] - 1)


def cell_name(column: int, row: int) -> str:
    """Name of a cell as a person calls it: ``top left``."""
    return f"{_ROWS[row]} {_COLUMNS[column]}"


def empty_cells(circles: Sequence[ContactCircle], grid: PixelGrid) -> list[str]:
    """Names of the cells that no contact's centre lies in."""
    used = {cell_of(circle, grid.width_px, grid.height_px) for circle in circles}
    return [cell_name(*cell) for cell in _CELLS if cell not in used]


DEPTHS = ("light", "medium", "deep")
SHARES = (0.5, 0.7, 0.9)
"""Contact radius of each depth, as parts of the deepest one's."""


@dataclass(frozen=True)
class Advice:
    """The press that is missing most."""

    cell: tuple[int, int]
    """Column and row of the coverage table."""
    depth: str
    radius_px: float | None
    """Radius of its contact; None where nothing tells yet how large one is."""

    def __str__(self) -> str:
        wide = (
            "" if self.radius_px is None else f", a contact about {2 * self.radius_px:.0f} px wide"
        )
        return f"{cell_name(*self.cell)}, {self.depth}{wide}"


def next_press(
    circles: Sequence[ContactCircle], size_px: tuple[int, int], deepest_px: float | None
) -> Advice:
    """The place and depth that the presses so far lack most.

    Args:
        circles: Contacts so far.
        size_px: Width and height of the image.
        deepest_px: Contact radius of the deepest press that is wanted, where ball and scale tell
            it; the largest so far when None.
    """
    if deepest_px is None and circles:
        deepest_px = max(circle.radius_px for circle in circles)
    made = Counter(cell_of(circle, *size_px) for circle in circles)
    cell = min(_CELLS, key=lambda one: made[one])
    if deepest_px is None:
        return Advice(cell, DEPTHS[1], None)
    depths = Counter(
        (cell_of(circle, *size_px), depth_of(circle, deepest_px)) for circle in circles
    )
    over_all = Counter(depth_of(circle, deepest_px) for circle in circles)
    depth = min(range(len(DEPTHS)), key=lambda k: (depths[cell, k], over_all[k], (1, 0, 2)[k]))
    return Advice(cell, DEPTHS[depth], SHARES[depth] * deepest_px)


def depth_of(circle: ContactCircle, deepest_px: float) -> int:
    """Which of the depths a contact is nearest to."""
    share = circle.radius_px / deepest_px
    return min(range(len(SHARES)), key=lambda k: abs(SHARES[k] - share))


def contact_radius_mm(ball_mm: float, depth_mm: float) -> float:
    """Radius of a ball's contact at a depth [mm], at most the ball's own."""
    depth_mm = min(depth_mm, ball_mm)
    return math.sqrt(2 * ball_mm * depth_mm - depth_mm**2)
