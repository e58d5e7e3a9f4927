# SPDX-License-Identifier: Apache-2.0
"""Chessboards and ChArUco boards: inner corners to a few hundredths of a pixel, of whole boards and
parts of them.

Whole boards are found by OpenCV's sector-based detector (A. Duda and U. Frese, "Accurate detection
and localization of checkerboard corners for calibration", BMVC 2018). Where corners are hidden or
blurred, saddle points of the brightness are indexed as a lattice instead. White squares of ChArUco
boards carry ArUco markers, so that any part of one tells which corners it shows, and a mirrored one
shows no markers at all.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial import KDTree

from taccel_lab.calibration.camera.board import BoardView, board_lattice, oriented
from taccel_lab.errors import InputError
from taccel_lab.guards import unknown
from taccel_lab.reading.dots.blobs import find_blobs, is_inside

MIN_SHARE = 0.5
"""Least share of the corners that a partly hidden board must show."""
MIN_POINTS = 12
_MIN_CHARUCO = 6
_WEAKEST = 0.2
"""Weakest saddle point that may be a corner, as a share of the usual one."""
_RING = 24
_OPPOSITE = 0.25
"""Mean difference of opposite points around a corner, as a share of the contrast, at most."""
_SMALL_PX = 500
"""Images narrower than this are doubled when the board is not found at once."""


def detect_chessboard(
    image: np.ndarray, columns: int, rows: int, *, name: str = "image"
) -> BoardView:
    """Find a chessboard of ``columns`` x ``rows`` inner corners.

    Args:
        image: RGB levels, uint8, shape [height_px, width_px, 3].

    Raises:
        InputError: Too few corners, saying how many were found; or fewer than 3 on a side.
    """
    if min(columns, rows) < 3:
        raise InputError(
            f"{name}: a chessboard needs at least 3 x 3 inner corners, {columns} x {rows} given"
        )
    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    uv = _whole_board(grey, columns, rows)
    index = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    if uv is None:
        index, uv = _part_of_board(grey, columns, rows, name)
    index = oriented(index, uv, columns == rows)
    size = (image.shape[1], image.shape[0])
    return BoardView(name, name, size, index, uv, columns * rows)


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


def _part_of_board(
    grey: np.ndarray, columns: int, rows: int, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Indices [n, 2] and corners [n, 2] of the part of the board that can be seen.

    OpenCV's own search for parts (``CALIB_CB_LARGER`` from 3 x 3 on) gives the largest full
    rectangle alone: 9 corners where a hand covers one corner of a board, and 19.7 against 24.4 on
    average over real boards of 36 with covers over one side or corner.
    """
    expected = columns * rows
    least = max(MIN_POINTS, int(np.ceil(MIN_SHARE * expected)))
    best, strangers = None, 0
    for sigma in (1.0, 1.5, 2.5, 4.0):
        uv = saddle_points(grey, sigma, 3 * expected)
        lattice = board_lattice(uv, columns, rows)
        if lattice is not None and (best is None or len(lattice.points) > len(best[0])):
            best, strangers = (lattice.index, uv[lattice.points]), lattice.strangers
    count = 0 if best is None else len(best[0])
    if best is not None and strangers > 2:
        raise InputError(
            f"{name}: the corners go on beyond {columns} x {rows}: {count + strangers} lie on one "
            f"lattice, {expected} are allowed; check columns and rows (inner corners are counted)"
        )
    if best is None or count < least:
        raise InputError(
            f"{name}: found {count} of {expected} inner corners of the {columns} x {rows} "
            f"chessboard, at least {least} are needed; check columns and rows (inner corners, not "
            "squares), focus, glare, and that the board is in view"
        )
    return best


def saddle_points(grey: np.ndarray, sigma_px: float, most: int) -> np.ndarray:
    """Strongest saddle points of the brightness, refined, shape [n, 2].

    Where two dark squares meet, the Hessian's determinant is most negative.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), sigma_px)
    xx = cv2.Sobel(smooth, cv2.CV_32F, 2, 0, ksize=3)
    yy = cv2.Sobel(smooth, cv2.CV_32F, 0, 2, ksize=3)
    xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=3) / 2.0
    strength = np.asarray(xy * xy - xx * yy / 4.0, dtype=np.float32)
    uv, peak = find_blobs(strength, 2 * sigma_px, 1, float(np.finfo(np.float32).tiny))
    inside = is_inside(uv, strength.shape, 4 * sigma_px + 1)
    uv, peak = uv[inside][:most], peak[inside][:most]
    if len(uv) == 0:
        return np.zeros((0, 2))
    # Half of the corners show at least: where squares end, saddles are far weaker.
    usual = float(np.median(peak[: max(most // 6, 1)]))
    corners = uv[peak > _WEAKEST * usual].astype(np.float32).reshape(-1, 1, 2)
    half = max(2, round(2.5 * sigma_px))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    refined = cv2.cornerSubPix(grey, corners, (half, half), (-1, -1), criteria).reshape(-1, 2)
    moved = np.linalg.norm(refined - corners.reshape(-1, 2), axis=1) < half
    refined = refined[moved].astype(np.float64)
    refined = refined[_crossings(smooth, refined, max(3.0, 2.5 * sigma_px))]
    # The refinement may draw two peaks to one corner.
    pairs = KDTree(refined).query_pairs(1.0) if len(refined) else set()
    doubled = {max(pair) for pair in pairs}
    return refined[[i for i in range(len(refined)) if i not in doubled]]


def _crossings(smooth: np.ndarray, uv: np.ndarray, radius_px: float) -> np.ndarray:
    """Points [n, 2] where two dark squares meet, bool: on a ring around, opposite points are alike
    and dark and light take turns twice. The outer corners of squares are not so."""
    angles = np.arange(_RING) * (2 * np.pi / _RING)
    ring = uv[:, None] + radius_px * np.column_stack([np.cos(angles), np.sin(angles)])
    at = ring.astype(np.float32)
    values = cv2.remap(
        smooth, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).reshape(len(uv), _RING)
    low, high = values.min(axis=1), values.max(axis=1)
    contrast = np.maximum(high - low, 1e-6)
    opposite = np.abs(values - np.roll(values, _RING // 2, axis=1)).mean(axis=1) / contrast
    dark = values < ((low + high) / 2)[:, None]
    turns = (dark != np.roll(dark, 1, axis=1)).sum(axis=1)
    return (opposite < _OPPOSITE) & (turns == 4)


def charuco_board(
    columns: int, rows: int, marker_share: float, dictionary: str, *, legacy: bool = False
) -> cv2.aruco.CharucoBoard:
    """OpenCV's board of ``columns`` x ``rows`` squares of size 1; markers ``marker_share`` of it.

    ``legacy``: the layout of OpenCV before 4.6, which differs for even numbers of rows.
    """
    code = getattr(cv2.aruco, dictionary, None)
    if not dictionary.startswith("DICT_") or not isinstance(code, int):
        known = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
        raise InputError(f"unknown ArUco dictionary {dictionary!r}{unknown(dictionary, known)}")
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
    if len(uv) < _MIN_CHARUCO or not (np.ptp(index, axis=0) >= 1).all():
        flipped = [_corners(np.ascontiguousarray(grey[:, ::-1]), board) for board in layouts]
        most = max(flipped, key=lambda item: len(item[1]))
        if len(most[1]) >= _MIN_CHARUCO and len(most[1]) > len(uv):
            raise InputError(
                f"{name}: the board is mirrored: as it is, {len(uv)} of {expected} corners show, "
                f"flipped left to right {len(most[1])}. Turn the picture round where it is "
                "recorded, so that x to y turns as on the board"
            )
        raise InputError(
            f"{name}: found {len(uv)} of {expected} corners and {markers} of "
            f"{columns * rows // 2} markers of the {columns} x {rows} charuco board; at least "
            f"{_MIN_CHARUCO} corners on more than one line are needed. Check columns and rows "
            f"(squares), the dictionary ({dictionary}), focus and light"
        )
    size = (image.shape[1], image.shape[0])
    return BoardView(name, name, size, index, uv, expected)


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
