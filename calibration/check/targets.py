# SPDX-License-Identifier: Apache-2.0
"""Findings about boards, edges, markers, videos and force records."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from taccel_lab.calibration.camera.find_boards import detect_views
from taccel_lab.calibration.capture.folder import (
    BoardCaptures,
    CaptureFolder,
    EdgeCapture,
    ForceRecord,
    MarkerCaptures,
    Video,
)
from taccel_lab.calibration.capture.framing import thumb
from taccel_lab.calibration.capture.record_checks import LIKELY_MPA, apparent_modulus_mpa
from taccel_lab.calibration.capture.video import cut_short
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.findings import name_some
from taccel_lab.calibration.dots.marker_picture import find_markers
from taccel_lab.calibration.markers.rest import find_rest
from taccel_lab.errors import InputError
from taccel_lab.report.remark import Remark

GOOD_VIEWS, FEW_VIEWS = 15, 6
BOARD_COVERAGE = 0.5
STILL_LEVELS = 0.05
"""Frames that differ less, at their strongest, are one frame stored twice."""
MAX_STILL_SHARE = 0.3
GOOD_POINTS = 5
LABEL_DOT_PX, LABELS_LOST = 3.0, 0.1


def check_targets(folder: CaptureFolder) -> list[Remark]:
    """All findings of this module."""
    findings = [finding for board in folder.boards for finding in _check_board(board)]
    if folder.markers is not None:
        findings += _check_markers(folder.markers)
    findings += _check_edges(folder.edges)
    findings += [finding for record in folder.records for finding in _check_record(record)]
    return findings


def _check_board(board: BoardCaptures) -> list[Remark]:
    entry = board.entry
    what = f"{entry.kind} {entry.columns} x {entry.rows}"
    use = ("scale",) if entry.on_gel else ("camera",)
    try:
        found = detect_views([board])
    except InputError as fault:
        return [remarks.BOARD_NOT_FOUND(board=what, reason=fault, blocks=use)]
    findings = []
    if found.refused:
        findings.append(
            remarks.BOARD_VIEWS_LOST(
                board=what,
                found=len(found.views),
                count=len(board.frames),
                reason=found.refused[0],
                frames=[
                    f.name for f in board.frames if f.name not in {v.name for v in found.views}
                ],
                blocks=use,
            )
        )
    findings += [
        remarks.BOARD_DOUBTFUL(board=what, reason=text, blocks=use) for text in found.warnings
    ]
    partial = [view.name for view in found.views if len(view.index) < view.expected]
    if partial:
        fewest = min(len(view.index) for view in found.views)
        findings.append(
            remarks.BOARD_POINTS_MISSING(
                board=what,
                count=len(partial),
                expected=found.views[0].expected,
                fewest=fewest,
                names=name_some(partial),
                frames=partial,
                blocks=use,
            )
        )
    if entry.on_gel:
        if entry.pitch_mm is None:
            findings.append(remarks.BOARD_WITHOUT_PITCH(board=what, blocks=use))
        return findings
    if len(found.views) < GOOD_VIEWS:
        findings.append(
            remarks.FEW_VIEWS(
                board=what,
                count=len(found.views),
                enough=GOOD_VIEWS,
                grave=len(found.views) < FEW_VIEWS,
                blocks=use,
            )
        )
    points = np.concatenate([view.uv_px for view in found.views])
    width, height = found.views[0].size_px
    cells = {(int(u / width * 4), int(v / height * 4)) for u, v in points}
    if len(cells) < BOARD_COVERAGE * 16:
        findings.append(remarks.BOARD_COVERAGE(board=what, cells=len(cells), blocks=use))
    return findings


def _check_markers(markers: MarkerCaptures) -> list[Remark]:
    findings = _check_labels(markers)
    try:
        rest = find_rest(markers)
    except InputError as fault:
        return [*findings, remarks.NO_REST_FRAME(reason=fault)]
    image = rest.frame.image()
    try:
        picture = find_markers(image)
    except InputError as fault:
        return [remarks.NO_MARKERS(name=rest.frame.name, reason=fault)]
    findings += [replace(remark, blocks=("markers", "scale")) for remark in rest.remarks]
    if markers.pitch_x_mm is None:
        findings.append(remarks.MARKER_PITCH_UNSTATED(count=picture.dots.count))
    for video in markers.videos:
        findings += _check_video(video, image)
    if not markers.videos:
        findings.append(remarks.NO_MARKER_VIDEOS())
    return findings


def _check_labels(markers: MarkerCaptures) -> list[Remark]:
    """Whether measured dots lie where the image that they were measured in shows some."""
    frame = markers.rest if markers.labels_frame is None else markers.labels_frame
    if not markers.labels or frame is None:
        return []
    try:
        near = find_markers(frame.image()).dots.uv_px
    except InputError as fault:
        return [remarks.NO_MARKERS(name=frame.name, reason=fault)]
    u, v, du, dv = (markers.labels[name] for name in ("u_px", "v_px", "du_px", "dv_px"))
    given = np.column_stack([u + du, v + dv])
    gap = np.linalg.norm(given[:, None] - near[None], axis=-1).min(axis=1)
    lost = int((gap > LABEL_DOT_PX).sum())
    if lost <= LABELS_LOST * len(gap):
        return []
    return [
        remarks.MARKER_LABELS_OFF(
            lost=lost, count=len(gap), name=frame.name, limit=LABEL_DOT_PX, median=np.median(gap)
        )
    ]


def _check_video(video: Video, rest: np.ndarray) -> list[Remark]:
    findings = _check_whole(video)
    small = []
    for frame in video.frames():
        if frame.shape != rest.shape:
            return [
                remarks.VIDEO_SIZE(
                    video=video.source,
                    width=frame.shape[1],
                    height=frame.shape[0],
                    rest_width=rest.shape[1],
                    rest_height=rest.shape[0],
                )
            ]
        small.append(thumb(frame))
    steps = np.array([float(np.abs(b - a).max()) for a, b in itertools.pairwise(small)])
    still = float((steps < STILL_LEVELS).mean())
    if still > MAX_STILL_SHARE:
        findings.append(remarks.VIDEO_REPEATS(video=video.source, still=still, count=len(small)))
    moved = max(float(np.percentile(np.abs(image - small[0]), 99)) for image in small)
    if moved < 4.0:
        findings.append(remarks.NO_MOTION(video=video.source, count=len(small)))
    return findings


def _check_whole(video: Video) -> list[Remark]:
    """Whether as many frames decode as the file says it has."""
    fault = cut_short(video)
    return [] if fault is None else [remarks.VIDEO_CUT_SHORT(reason=fault)]


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
            findings.append(
                remarks.EDGE_LABELS_OFF(
                    count=len(off), mm_per_px=middle, names=name_some(off), frames=off
                )
            )
    return findings


def _check_record(record: ForceRecord) -> list[Remark]:
    entry, columns = record.entry, record.columns
    rows = len(next(iter(columns.values())))
    findings = []
    if rows < GOOD_POINTS:
        findings.append(remarks.FEW_POINTS(record=record.source, count=rows, enough=GOOD_POINTS))
    if entry.tool.radius_mm is None and entry.tool.kind != "flat":
        findings.append(remarks.TOOL_UNKNOWN(record=record.source, tool=entry.tool.kind))
    if entry.force_sigma_n is None and "sigma_n" not in columns:
        findings.append(remarks.FORCE_SIGMA_UNSTATED(record=record.source))
    if entry.kind == "indentation" and entry.tool.radius_mm is not None:
        modulus = apparent_modulus_mpa(
            columns["depth_mm"], columns["force_n"], entry.tool.radius_mm
        )
        if not LIKELY_MPA[0] <= modulus <= LIKELY_MPA[1]:
            findings.append(
                remarks.MODULUS_UNUSUAL(
                    record=record.source, modulus=modulus, low=LIKELY_MPA[0], high=LIKELY_MPA[1]
                )
            )
    return findings
