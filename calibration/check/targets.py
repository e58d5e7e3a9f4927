# SPDX-License-Identifier: Apache-2.0
"""Findings about boards, edges, markers, videos and force records."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

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
from taccel_lab.calibration.capture.record_checks import LIKELY_MPA, apparent_modulus_mpa
from taccel_lab.calibration.capture.video import cut_short
from taccel_lab.calibration.check.findings import Finding, error, info, name_some, warning
from taccel_lab.calibration.check.framing import thumb
from taccel_lab.calibration.dots.marker_picture import find_markers
from taccel_lab.errors import InputError

GOOD_VIEWS, FEW_VIEWS = 15, 6
BOARD_COVERAGE = 0.5
STILL_LEVELS = 0.05
"""Frames that differ less, at their strongest, are one frame stored twice."""
MAX_STILL_SHARE = 0.3
GOOD_POINTS = 5
LABEL_DOT_PX = 3.0


def check_targets(folder: CaptureFolder) -> list[Finding]:
    """All findings of this module."""
    findings = [finding for board in folder.boards for finding in _check_board(board)]
    if folder.markers is not None:
        findings += _check_markers(folder.markers)
    findings += _check_edges(folder.edges)
    findings += [finding for record in folder.records for finding in _check_record(record)]
    return findings


def _check_board(board: BoardCaptures) -> list[Finding]:
    entry = board.entry
    what = f"{entry.kind} {entry.columns} x {entry.rows}"
    use = "scale" if entry.on_gel else "camera"
    try:
        found = detect_views([board])
    except InputError as fault:
        return [error("board_not_found", f"{what}: {fault}", use)]
    findings = []
    if found.refused:
        findings.append(
            warning(
                "board_views_lost",
                f"{what}: found in {len(found.views)} of {len(board.frames)} images. "
                f"{found.refused[0]}",
                use,
                frames=[
                    f.name for f in board.frames if f.name not in {v.name for v in found.views}
                ],
            )
        )
    findings += [warning("board_doubtful", f"{what}: {text}", use) for text in found.warnings]
    partial = [view.name for view in found.views if len(view.index) < view.expected]
    if partial:
        fewest = min(len(view.index) for view in found.views)
        findings.append(
            info(
                "board_points_missing",
                f"{what}: {len(partial)} views show not all {found.views[0].expected} points "
                f"(fewest {fewest}): {name_some(partial)}",
                use,
                frames=partial,
            )
        )
    if entry.on_gel:
        if entry.pitch_mm is None:
            findings.append(
                error("board_without_pitch", f"{what} on the gel needs pitch_mm for a scale", use)
            )
        return findings
    if len(found.views) < GOOD_VIEWS:
        make = warning if len(found.views) < FEW_VIEWS else info
        findings.append(
            make(
                "few_views",
                f"{what}: {len(found.views)} views; {GOOD_VIEWS} and more, tilted by up to 40 deg "
                "and reaching into every corner, tell distortion",
                use,
            )
        )
    points = np.concatenate([view.uv_px for view in found.views])
    width, height = found.views[0].size_px
    cells = {(int(u / width * 4), int(v / height * 4)) for u, v in points}
    if len(cells) < BOARD_COVERAGE * 16:
        findings.append(
            warning(
                "board_coverage",
                f"{what}: the views cover {len(cells)} of 16 parts of the image; distortion is "
                "unknown elsewhere",
                use,
            )
        )
    return findings


def _check_markers(markers: MarkerCaptures) -> list[Finding]:
    findings = []
    try:
        picture = find_markers(markers.rest.image())
    except InputError as fault:
        return [error("no_markers", f"{markers.rest.name}: {fault}", "markers")]
    if markers.pitch_x_mm is None:
        findings.append(
            info(
                "marker_pitch_unstated",
                f"{picture.dots.count} dots at rest; their pitch in mm is not stated, so they give "
                "no scale",
                "scale",
            )
        )
    if markers.labels:
        near = picture.dots.uv_px
        given = np.column_stack([markers.labels["u_px"], markers.labels["v_px"]])
        gap = np.linalg.norm(given[:, None] - near[None], axis=-1).min(axis=1)
        lost = int((gap > LABEL_DOT_PX).sum())
        if lost > 0.1 * len(gap):
            findings.append(
                warning(
                    "marker_labels_off",
                    f"{lost} of {len(gap)} measured dots are more than {LABEL_DOT_PX:g} px from "
                    f"any dot of the image (median {np.median(gap):.1f} px)",
                    "markers",
                )
            )
    for video in markers.videos:
        findings += _check_video(video, markers.rest.image())
    if not markers.videos:
        findings.append(
            info("no_motion", "no video of moving dots: layout only, no tracking", "markers")
        )
    return findings


def _check_video(video: Video, rest: np.ndarray) -> list[Finding]:
    frames = video.frames()
    findings = _check_whole(video)
    sizes = {frame.shape for frame in frames}
    if sizes != {rest.shape}:
        return [
            error(
                "video_size",
                f"{video.source}: frames of {frames[0].shape[1]}x{frames[0].shape[0]} px, the "
                f"image at rest has {rest.shape[1]}x{rest.shape[0]} px",
                "markers",
            )
        ]
    small = [thumb(frame) for frame in frames]
    steps = np.array([float(np.abs(b - a).max()) for a, b in itertools.pairwise(small)])
    still = float((steps < STILL_LEVELS).mean())
    if still > MAX_STILL_SHARE:
        findings.append(
            warning(
                "video_repeats",
                f"{video.source}: {still:.0%} of its {len(frames)} frames repeat the one before: "
                "the recorder was faster than the camera, or the video stands still",
                "markers",
            )
        )
    moved = max(float(np.percentile(np.abs(image - small[0]), 99)) for image in small)
    if moved < 4.0:
        findings.append(
            warning(
                "no_motion", f"{video.source}: nothing moves in {len(frames)} frames", "markers"
            )
        )
    return findings


def _check_whole(video: Video) -> list[Finding]:
    """Whether as many frames decode as the file says it has."""
    fault = cut_short(video)
    return [] if fault is None else [warning("video_cut_short", fault, "markers")]


def _check_edges(edges: Sequence[EdgeCapture]) -> list[Finding]:
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
                warning(
                    "edge_labels_off",
                    f"{len(off)} labelled edges are more than 15 % longer or shorter than the "
                    f"others, which say {middle:.4f} mm/px: {name_some(off)}",
                    "scale",
                    frames=off,
                )
            )
    return findings


def _check_record(record: ForceRecord) -> list[Finding]:
    entry, columns = record.entry, record.columns
    rows = len(next(iter(columns.values())))
    findings = []
    if rows < GOOD_POINTS:
        findings.append(
            warning(
                "few_points",
                f"{record.source}: {rows} points; {GOOD_POINTS} and more tell modulus and law "
                "apart",
                "material",
            )
        )
    if entry.tool.radius_mm is None and entry.tool.kind != "flat":
        findings.append(
            error(
                "tool_unknown",
                f"{record.source}: the radius of the {entry.tool.kind} is missing; give "
                "tool = { kind, radius_mm }",
                "material",
            )
        )
    if entry.force_sigma_n is None and "sigma_n" not in columns:
        findings.append(
            info(
                "force_sigma_unstated",
                f"{record.source}: no force_sigma_n; the scatter of the fit stands in for it",
                "material",
            )
        )
    if entry.kind == "indentation" and entry.tool.radius_mm is not None:
        modulus = apparent_modulus_mpa(
            columns["depth_mm"], columns["force_n"], entry.tool.radius_mm
        )
        if not LIKELY_MPA[0] <= modulus <= LIKELY_MPA[1]:
            findings.append(
                warning(
                    "modulus_unusual",
                    f"{record.source}: by Hertz the gel would have {modulus:.3g} MPa, gels on a "
                    f"window look {LIKELY_MPA[0]:g} to {LIKELY_MPA[1]:g} MPa: check the units of "
                    "force and depth and the tool's radius",
                    "material",
                )
            )
    return findings
