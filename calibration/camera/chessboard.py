# SPDX-License-Identifier: Apache-2.0
"""Chessboards: all inner corners to a few hundredths of a pixel.

They are found by OpenCV's sector-based detector (A. Duda and U. Frese, "Accurate detection and
localization of checkerboard corners for calibration", BMVC 2018); of a board that is partly hidden
ChArUco's corners have numbers.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from taccel_lab.calibration.camera.board import BoardView, oriented
from taccel_lab.errors import InputError

_SMALL_PX = 500
"""Images narrower than this are doubled when the board is not found at once."""


def detect_chessboard(
    image: np.ndarray, columns: int, rows: int, *, name: str = "image"
) -> BoardView:
    """Find a chessboard of ``columns`` x ``rows`` inner corners.

    Args:
        image: RGB levels, uint8, shape [height_px, width_px, 3].

    Raises:
        InputError: Not all corners are found, or fewer than 3 on a side are asked for.
    """
    if min(columns, rows) < 3:
        raise InputError(
            f"{name}: a chessboard needs at least 3 x 3 inner corners, {columns} x {rows} given"
        )
    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    uv = _whole_board(grey, columns, rows)
    index = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    if uv is None:
        raise InputError(
            f"{name}: the {columns} x {rows} inner corners of the chessboard are not all found; "
            "check columns and rows (inner corners, not squares), focus, glare, and that the whole "
            "board is in view; a ChArUco board may be partly hidden"
        )
    index = oriented(index, uv, columns == rows)
    size = (image.shape[1], image.shape[0])
    view = BoardView(name, name, size, index, uv, columns * rows)
    return replace(view, first_square_dark=_first_square_dark(grey, view, columns, rows))


def _whole_board(grey: np.ndarray, columns: int, rows: int) -> np.ndarray | None:
    """All corners in the detector's order, shape [columns * rows, 2], or None."""
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    even = cv2.createCLAHE(clipLimit=3.0, tileGridSize=(8, 8)).apply(grey)
    pictures = [(grey, 1), (even, 1)]
    if grey.shape[1] < _SMALL_PX:
        doubled = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        pictures.append((doubled, 2))
    for picture, scale in pictures:
        found, corners = cv2.findChessboardCornersSB(picture, (columns, rows), flags=flags)
        if found and corners is not None and len(corners) == columns * rows:
            return (corners.reshape(-1, 2).astype(np.float64) + 0.5) / scale - 0.5
    return None


def _first_square_dark(grey: np.ndarray, view: BoardView, columns: int, rows: int) -> bool | None:
    """Colour of the square between corners (0, 0) and (1, 1), where it tells a mirrored board.

    It does on boards whose numbers of squares are both even and differ: a half turn keeps the
    colours, a mirror swaps them. Other boards look the same mirrored and turned.
    """
    if columns % 2 == 0 or rows % 2 == 0 or columns == rows or len(view.index) != view.expected:
        return None
    dark, light = [], []
    at = {tuple(key): uv for key, uv in zip(view.index.tolist(), view.uv_px, strict=True)}
    for (i, j), uv in at.items():
        if (i + 1, j + 1) in at:
            u, v = np.rint((uv + at[i + 1, j + 1]) / 2).astype(int)
            (dark if (i + j) % 2 == 0 else light).append(float(grey[v, u]))
    # The board's first square lies before corner (0, 0) and has the colour of the one behind it.
    return bool(np.mean(dark) < np.mean(light))
