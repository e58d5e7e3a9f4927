# SPDX-License-Identifier: Apache-2.0
"""Detection of any board that a capture folder may hold, view by view.

Boards of dots are printed ones that the camera sees, or pressed ones that show as a difference.
Dots are found as markers on the gel are, whatever their size and sign; what a board adds is its
known number of columns and rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import KDTree

from taccel_lab.calibration.camera.board import BoardLattice, BoardView, board_lattice
from taccel_lab.calibration.camera.chessboard import detect_charuco, detect_chessboard
from taccel_lab.calibration.capture.folder import BoardCaptures
from taccel_lab.calibration.capture.schema import BoardEntry
from taccel_lab.errors import InputError
from taccel_lab.guards import require_size
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.dots.detection import Dots
from taccel_lab.reading.dots.dot_fit import fit_dots
from taccel_lab.reading.dots.marker_picture import markers_or_none

MIN_SHARE = 0.4
"""Least share of the dots that must be found."""
MIN_POINTS = 9
_SAME_PITCHES = 0.3
"""Two pictures of a dot are this near each other at most."""
_SMOOTHED, _AROUND = (0.25, 0.5), 1.0
"""Widths of Gaussians, in radii of the dents: two that smooth, and one whose result is what a dent
stands out from."""
_GREY = 128.0
_IRREGULAR = 0.12
"""Largest error of predicting a lattice's point from its neighbours, root mean square in pitches:
0.04 to 0.10 on real boards (9DTact, Photon26), 0.13 and more among random points."""


def detect_dots(
    image: np.ndarray,
    columns: int,
    rows: int,
    *,
    reference: np.ndarray | None = None,
    name: str = "image",
) -> BoardView:
    """Find a board of ``columns`` x ``rows`` dots; some may be missing.

    Args:
        image: RGB levels, shape [height_px, width_px, 3].
        reference: The same view without the board, of the same size: what changed is looked at.

    Raises:
        InputError: Too few dots on a lattice, or more than the board has; with the numbers.
    """
    expected = columns * rows
    least = max(MIN_POINTS, int(np.ceil(MIN_SHARE * expected)))
    pictures = _pictures(image, reference, name)
    seen = [(picture, _find(picture, columns, rows)) for picture in pictures]
    found = [(picture, *of_board) for picture, of_board in seen if of_board is not None]
    _, lattice, dots = max(
        found, key=lambda item: len(item[1].index) - item[1].strangers, default=(None, None, None)
    )
    count = 0 if lattice is None else len(lattice.index)
    if lattice is None or dots is None or count < least:
        raise InputError(
            f"{name}: found {count} of {expected} dots of the {columns} x {rows} board on a "
            f"lattice, at least {least} are needed; check columns and rows, focus and light, or "
            "give a reference image without the board"
        )
    if lattice.strangers > max(2, 0.1 * count):
        raise InputError(
            f"{name}: the dots go on beyond {columns} x {rows}: {count + lattice.strangers} lie on "
            f"one lattice, {expected} are allowed; check columns and rows"
        )
    span = np.ptp(lattice.index, axis=0) + 1
    if min(span) < 3:
        raise InputError(
            f"{name}: the {count} dots found span {span[0]} x {span[1]} sites; at least 3 x 3"
        )
    places = [other.uv_px for _, _, other in found if other is not dots]
    if reference is not None:
        places += [uv for picture, _, other in found for uv in _through_filters(picture, other)]
    same = (_same_dots(place, dots.uv_px) for place in places)
    others = tuple(place for place in same if place is not None)
    size = image.shape[1], image.shape[0]
    return BoardView(name, name, size, lattice.index, dots.uv_px, expected, others_uv_px=others)


def _find(picture: np.ndarray, columns: int, rows: int) -> tuple[BoardLattice, Dots] | None:
    """The board's lattice in a picture, and its dots."""
    shown = markers_or_none(picture)
    lattice = None if shown is None else board_lattice(shown.dots.uv_px, columns, rows)
    if shown is None or lattice is None or lattice.irregularity > _IRREGULAR:
        return None
    return lattice, shown.dots.select(lattice.points)


def _same_dots(seen: np.ndarray, asked: np.ndarray) -> np.ndarray | None:
    """Places ``seen`` [m, 2] nearest to those ``asked`` for [n, 2]; None where one is too far."""
    pitch = float(np.median(KDTree(asked).query(asked, k=2)[0][:, 1]))
    distance, nearest = KDTree(seen).query(asked)
    return seen[nearest] if distance.max() < _SAME_PITCHES * pitch else None


def _through_filters(picture: np.ndarray, dots: Dots) -> list[np.ndarray]:
    """Where filters of several widths show the dots of a picture, each [n, 2]. A dent's shading is
    no disc: where its centre is seen depends on the filter, alike for all dents of a side."""
    radius = float(np.median(dots.radius_px))
    smooth = [cv2.GaussianBlur(picture, (0, 0), share * radius) for share in _SMOOTHED]
    against = _GREY + picture - cv2.GaussianBlur(picture, (0, 0), _AROUND * radius)
    again = [fit_dots(filtered, dots.parameters) for filtered in (*smooth, against)]
    return [np.where(fit.placed[:, None], fit.uv_px, dots.uv_px) for fit in again]


def _pictures(image: np.ndarray, reference: np.ndarray | None, name: str) -> list[np.ndarray]:
    """Grey pictures in which dots may stand out, float32, shape [height_px, width_px]."""
    levels = np.asarray(image, dtype=np.float32)
    if reference is None:
        return [levels.mean(axis=2)]
    require_size(name, image.shape[1::-1], "its reference", reference.shape[1::-1])
    change = levels - np.asarray(reference, dtype=np.float32)
    change -= np.median(change, axis=(0, 1))
    # A dent darkens a depth sensor and colours a photometric one, each side differently.
    return [_GREY + change.mean(axis=2), _GREY + np.linalg.norm(change, axis=2)]


@dataclass(frozen=True)
class Detections:
    """Views in which the board was found, and why it was not in the others."""

    views: tuple[BoardView, ...]
    refused: tuple[str, ...] = ()


def detect_board(
    image: np.ndarray, entry: BoardEntry, *, reference: np.ndarray | None = None, name: str
) -> BoardView:
    """Find the board of a manifest's entry in one RGB image; InputError says what is amiss."""
    if entry.kind == "chessboard":
        view = detect_chessboard(image, entry.columns, entry.rows, name=name)
    elif entry.kind == "charuco":
        if entry.marker_mm is None or entry.pitch_mm is None:
            raise InputError(
                f"{name}: a charuco board needs pitch_mm (size of a square) and marker_mm (size "
                "of a marker), also where no scale is wanted: their ratio says where corners lie"
            )
        view = detect_charuco(
            image,
            entry.columns,
            entry.rows,
            marker_share=entry.marker_mm / entry.pitch_mm,
            dictionary=entry.dictionary,
            name=name,
        )
    else:
        view = detect_dots(image, entry.columns, entry.rows, reference=reference, name=name)
    return replace(view, pitch_mm=entry.pitch_mm)


def detect_views(
    boards: Sequence[BoardCaptures], task: str = "finding boards", progress: Progress = silent
) -> Detections:
    """Detect every view of some boards.

    Views in which the board is not found, or that are one image twice, are rejected with the
    reason. Raises InputError when none is left.
    """
    views: list[BoardView] = []
    refused: list[str] = []
    seen: dict[str, str] = {}
    total, place = sum(len(board.frames) for board in boards), -1
    for board in boards:
        reference = None
        if board.reference is not None and (board.entry.on_gel or board.entry.kind == "pins"):
            reference = board.reference.image()
        for frame in board.frames:
            place += 1
            if frame.sha256 in seen:
                refused.append(f"{frame.source}: the same image as {seen[frame.sha256]}")
                continue
            seen[frame.sha256] = frame.source
            try:
                view = detect_board(
                    frame.image(), board.entry, reference=reference, name=frame.source
                )
                views.append(
                    replace(
                        view,
                        name=frame.name,
                        source=frame.source,
                        sha256=frame.sha256,
                        place=place,
                    )
                )
            except InputError as error:
                refused.append(str(error))
            progress(task, len(views) + len(refused), total)
    if total and not views:
        shown = "\n".join(refused[:5])
        more = f"\n... and {len(refused) - 5} more" if len(refused) > 5 else ""
        raise InputError(f"no board was found in any of {total} images:\n{shown}{more}")
    _check_one_size(views)
    return Detections(tuple(views), tuple(refused))


def _check_one_size(views: Sequence[BoardView]) -> None:
    sizes = Counter(view.size_px for view in views)
    if len(sizes) > 1:
        (usual, _), *others = sizes.most_common()
        odd = next(view for view in views if view.size_px == others[0][0])
        advice = "all have to be of one size and one sensor"
        require_size(odd.source, odd.size_px, "other views of boards are", usual, advice)
