# SPDX-License-Identifier: Apache-2.0
"""ChArUco boards: chessboards whose white squares carry ArUco markers, so that any part of one
tells which corners it shows, and a mirrored one shows no markers at all."""

from __future__ import annotations

import cv2
import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.errors import InputError

MIN_POINTS = 6


def charuco_board(
    columns: int, rows: int, marker_share: float, dictionary: str, *, legacy: bool = False
) -> cv2.aruco.CharucoBoard:
    """OpenCV's board of ``columns`` x ``rows`` squares of size 1; markers ``marker_share`` of it.

    ``legacy``: the layout of OpenCV before 4.6, which differs for even numbers of rows.
    """
    code = getattr(cv2.aruco, dictionary, None)
    if not dictionary.startswith("DICT_") or not isinstance(code, int):
        known = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
        raise InputError(f"unknown ArUco dictionary {dictionary!r}; one of {', '.join(known)}")
    if not 0.1 < marker_share < 1.0:
        raise InputError(
            f"markers must be smaller than the squares, got {marker_share:g} of their size; check "
            "marker_mm and pitch_mm"
        )
    table = cv2.aruco.getPredefinedDictionary(code)
    needed = columns * rows // 2
    if needed > len(table.bytesList):
        raise InputError(
            f"a charuco board of {columns} x {rows} squares carries {needed} markers, "
            f"{dictionary} holds {len(table.bytesList)}"
        )
    board = cv2.aruco.CharucoBoard((columns, rows), 1.0, marker_share, table)
    board.setLegacyPattern(legacy)
    return board


def detect_charuco(
    image: np.ndarray,
    columns: int,
    rows: int,
    *,
    marker_share: float,
    dictionary: str = "DICT_4X4_50",
    name: str = "image",
) -> BoardView:
    """Find a ChArUco board of ``columns`` x ``rows`` squares, or a part of it.

    Args:
        image: RGB levels, uint8, shape [height_px, width_px, 3].
        marker_share: Marker size over square size.

    Raises:
        InputError: The board is mirrored, or shows too few corners; with the numbers.
    """
    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    expected = (columns - 1) * (rows - 1)
    layouts = [
        charuco_board(columns, rows, marker_share, dictionary, legacy=legacy)
        for legacy in ((False, True) if rows % 2 == 0 else (False,))
    ]
    found = [_corners(grey, board) for board in layouts]
    index, uv, markers = max(found, key=lambda item: len(item[1]))
    if len(uv) < MIN_POINTS or not _spans(index):
        flipped = [_corners(np.ascontiguousarray(grey[:, ::-1]), board) for board in layouts]
        most = max(flipped, key=lambda item: len(item[1]))
        if len(most[1]) >= MIN_POINTS and len(most[1]) > len(uv):
            raise InputError(
                f"{name}: the board is mirrored: as it is, {len(uv)} of {expected} corners show, "
                f"flipped left to right {len(most[1])}. Turn the picture round where it is "
                "recorded, so that x to y turns as on the board"
            )
        raise InputError(
            f"{name}: found {len(uv)} of {expected} corners and {markers} of "
            f"{columns * rows // 2} markers of the {columns} x {rows} charuco board; at least "
            f"{MIN_POINTS} corners on more than one line are needed. Check columns and rows "
            f"(squares), the dictionary ({dictionary}), focus and light"
        )
    size = (image.shape[1], image.shape[0])
    return BoardView(name, name, size, index, uv, expected)


def _spans(index: np.ndarray) -> bool:
    return len(index) > 0 and bool((np.ptp(index, axis=0) >= 1).all())


def _corners(grey: np.ndarray, board: cv2.aruco.CharucoBoard) -> tuple[np.ndarray, np.ndarray, int]:
    """Indices [n, 2], corners [n, 2] and the number of markers found."""
    detector = cv2.aruco.CharucoDetector(board)
    corners, ids, _, marker_ids = detector.detectBoard(grey)
    markers = 0 if marker_ids is None else len(marker_ids)
    if corners is None or ids is None or len(corners) == 0:
        return np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)), markers
    wide = board.getChessboardSize()[0] - 1
    ids = np.asarray(ids).ravel()
    index = np.column_stack([ids % wide, ids // wide]).astype(np.int64)
    return index, np.asarray(corners, dtype=np.float64).reshape(-1, 2), markers
