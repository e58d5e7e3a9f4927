# SPDX-License-Identifier: Apache-2.0
"""Detection of any board that a capture folder may hold, view by view."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.chessboard import detect_charuco, detect_chessboard
from taccel_lab.calibration.camera.dot_board import detect_dots
from taccel_lab.calibration.capture.folder import BoardCaptures
from taccel_lab.calibration.capture.schema import BoardEntry
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent


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
        raise InputError(
            f"{odd.source} is {odd.size_px[0]}x{odd.size_px[1]} px, other views of boards are "
            f"{usual[0]}x{usual[1]} px; all have to be of one size and one sensor"
        )
