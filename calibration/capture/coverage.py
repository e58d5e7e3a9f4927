# SPDX-License-Identifier: Apache-2.0
"""Where on the image contacts were, by pixel and by the cells of a 4 x 3 table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.geometry import PixelGrid

CELLS = (4, 3)
"""Columns and rows of the coverage table."""
_COLUMNS, _ROWS = ("left", "left centre", "right centre", "right"), ("top", "middle", "bottom")


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
    cells = [(column, row) for row in range(CELLS[1]) for column in range(CELLS[0])]
    return [cell_name(*cell) for cell in cells if cell not in used]
