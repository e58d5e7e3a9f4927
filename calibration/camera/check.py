# SPDX-License-Identifier: Apache-2.0
"""Findings about boards: what cannot be found in their images, and what they miss of a lens."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.camera.find_boards import detect_views
from taccel_lab.calibration.camera.remarks import BOARDS_REFUSED, LENS_COVERAGE, MORE_VIEWS
from taccel_lab.calibration.capture.folder import BoardCaptures, CaptureFolder
from taccel_lab.calibration.remarks import TOO_FEW, error
from taccel_lab.errors import InputError
from taccel_lab.printable import counted
from taccel_lab.report.remark import Remark

GOOD_VIEWS = 10
BOARD_COVERAGE = 0.5
BOARD_NOT_FOUND = error("board_not_found", "{board} was not found: {reason}")
BOARD_WITHOUT_PITCH = error("board_without_pitch", "{board} on the gel needs pitch_mm for a scale")


def check_lens_boards(folder: CaptureFolder) -> list[Remark]:
    """Findings about boards that are held before the camera."""
    boards = [board for board in folder.boards if not board.entry.on_gel]
    return [finding for board in boards for finding in check_board(board)]


def check_board(board: BoardCaptures) -> list[Remark]:
    """Findings about the images of one board."""
    entry = board.entry
    what = f"{entry.kind} {entry.columns} x {entry.rows}"
    use = ("scale",) if entry.on_gel else ("camera",)
    try:
        found = detect_views([board])
    except InputError as fault:
        return [BOARD_NOT_FOUND(board=what, reason=fault, blocks=use)]
    findings = []
    if found.refused:
        count, total = len(found.refused), len(board.frames)
        seen = {view.name for view in found.views}
        findings.append(
            BOARDS_REFUSED(
                count=count,
                total=total,
                reasons=found.refused[0],
                frames=[frame.name for frame in board.frames if frame.name not in seen],
                blocks=use,
                grave=count * 3 > total,
            )
        )
    if entry.on_gel:
        if entry.pitch_mm is None:
            findings.append(BOARD_WITHOUT_PITCH(board=what, blocks=use))
        return findings
    if len(found.views) < GOOD_VIEWS:
        findings.append(
            TOO_FEW(
                found=f"{counted(len(found.views), 'view')} of {what}",
                wanted=MORE_VIEWS,
                blocks=use,
            )
        )
    points = np.concatenate([view.uv_px for view in found.views])
    width, height = found.views[0].size_px
    cells = {(int(u / width * 4), int(v / height * 4)) for u, v in points}
    if len(cells) < BOARD_COVERAGE * 16:
        findings.append(LENS_COVERAGE(share=len(cells) / 16, blocks=use))
    return findings
