# SPDX-License-Identifier: Apache-2.0
"""Findings about captures of known length: boards on the gel, markers and edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.camera.check import check_board
from taccel_lab.calibration.capture.folder import CaptureFolder, EdgeCapture
from taccel_lab.calibration.markers.check import check_rest
from taccel_lab.calibration.remarks import LABELS_OFF, name_some
from taccel_lab.report.remark import Remark


def check_known_lengths(folder: CaptureFolder) -> list[Remark]:
    """Findings about all of them."""
    boards = [board for board in folder.boards if board.entry.on_gel]
    findings = [finding for board in boards for finding in check_board(board)]
    if folder.markers is not None:
        findings += check_rest(folder).findings
    return findings + _check_edges(folder.edges)


def _check_edges(edges: Sequence[EdgeCapture]) -> list[Remark]:
    findings = []
    scales = [
        edge.entry.length_mm / edge.entry.line.length_px
        for edge in edges
        if edge.entry.line is not None
    ]
    if len(scales) > 2:
        middle = float(np.median(scales))
        off = [
            edge.frame.name
            for edge in edges
            if edge.entry.line is not None
            and abs(edge.entry.length_mm / edge.entry.line.length_px / middle - 1) > 0.15
        ]
        if off:
            how = f"more than 15 % longer or shorter than {middle:.4f} mm/px says; {name_some(off)}"
            figures = {"wrong": len(off), "count": len(scales), "advice": "Look at them"}
            findings.append(
                LABELS_OFF(
                    labels="labelled edges", how=how, frames=off, blocks=("scale",), **figures
                )
            )
    return findings
