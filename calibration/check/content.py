# SPDX-License-Identifier: Apache-2.0
"""What a folder holds for each block, what is missing, which command that stops, and findings about
boards, edges, markers, videos and force records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from taccel_lab.calibration.blocks import BLOCKS
from taccel_lab.calibration.camera import remarks as camera
from taccel_lab.calibration.camera.find_boards import detect_views
from taccel_lab.calibration.capture.folder import (
    BoardCaptures,
    CaptureFolder,
    EdgeCapture,
    ForceRecord,
    MarkerCaptures,
    Video,
)
from taccel_lab.calibration.capture.load import cut_short
from taccel_lab.calibration.capture.records import LIKELY_MPA, apparent_modulus_mpa
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.markers.remarks import VIDEO_CUT_SHORT
from taccel_lab.calibration.markers.rest import find_rest
from taccel_lab.calibration.remarks import LABELS_OFF, TOO_FEW, name_some
from taccel_lab.errors import InputError
from taccel_lab.printable import counted
from taccel_lab.reading.dots.marker_picture import find_markers
from taccel_lab.reading.thumb import thumb
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.sensors.registry import known_sensor

GOOD_VIEWS = 10
BOARD_COVERAGE = 0.5
LABEL_DOT_PX, LABELS_LOST = 3.0, 0.1


class Readiness(StrEnum):
    """Whether a command can be run on the folder."""

    READY = "ready"
    WEAK = "weak"
    """It runs; findings say why its result will not be good."""
    BLOCKED = "blocked"
    """Captures are there, and something stops the command."""
    ABSENT = "absent"
    """No captures for it: nothing wrong, nothing to do."""


@dataclass(frozen=True)
class BlockStatus:
    """One command and what the folder holds for it."""

    command: str
    readiness: Readiness
    found: str
    missing: str

    def to_dict(self) -> dict[str, str]:
        return {
            "command": f"taccel-lab calibrate {self.command}",
            "readiness": str(self.readiness),
            "found": self.found,
            "missing": self.missing,
        }


def check_content(folder: CaptureFolder) -> list[Remark]:
    """Things that captures which are there need and the manifest does not state."""
    findings = []
    if folder.presses and not folder.ball_radii_mm():
        findings.append(remarks.BALL_RADIUS_UNSTATED())
    if folder.presses and folder.mm_per_px is None and not _scale_sources(folder):
        findings.append(remarks.SCALE_UNSTATED())
    return findings


def _scale_sources(folder: CaptureFolder) -> list[str]:
    sources = []
    if any(board.entry.on_gel and board.entry.pitch_mm is not None for board in folder.boards):
        sources.append("board on the gel")
    if folder.edges:
        sources.append(counted(len(folder.edges), "edge"))
    if folder.markers is not None and folder.markers.pitch_x_mm is not None:
        sources.append("marker pitch")
    if any(press.depth_mm is not None for press in folder.presses):
        sources.append("ball presses with travel")
    return sources


def block_statuses(
    folder: CaptureFolder, findings: Sequence[Remark], *, grey: bool | None = None
) -> list[BlockStatus]:
    """Readiness of every command; ``grey`` says that grey levels stand for depth."""
    statuses = []
    for command in (block.name for block in BLOCKS):
        found, missing = _needs(folder, command)
        if grey is False and command == "depth":
            found, missing = "", "a sensor whose grey levels stand for depth, such as a 9DTact"
        if grey and command in ("color", "normals"):
            found, missing = "", "coloured lamps: this sensor, or these images, are grey"
        mine = {finding.severity for finding in findings if command in finding.blocks}
        if not found:
            readiness = Readiness.ABSENT
        elif missing or Severity.ERROR in mine:
            readiness = Readiness.BLOCKED
        else:
            readiness = Readiness.WEAK if Severity.WARNING in mine else Readiness.READY
        statuses.append(BlockStatus(command, readiness, found, missing))
    return statuses


def _scale_for_size(folder: CaptureFolder) -> str:
    """What a background of another size than the catalogue's images needs; empty for nothing."""
    family = known_sensor(folder.sensor)
    if family is None or folder.mm_per_px is not None or _scale_sources(folder):
        return ""
    height, width = folder.require_background().image().shape[:2]
    designed = family.parameters().grid()
    if (designed.width_px, designed.height_px) == (width, height):
        return ""
    return (
        f"the scale (these images are {width}x{height} px, those of the catalogue's "
        f"{folder.sensor} {designed.width_px}x{designed.height_px} px), or a --base with a "
        "calibrated camera"
    )


def _needs(folder: CaptureFolder, command: str) -> tuple[str, str]:
    """What is there for a command, and what is missing, both in words."""
    presses, labelled = len(folder.presses), sum(p.circle is not None for p in folder.presses)
    balls = ""
    if presses:
        balls = f"{counted(presses, 'ball press', 'ball presses')} ({labelled} with circles)"
    if command == "camera":
        views = sum(len(b.frames) for b in folder.boards)
        return (f"{counted(views, 'view')} of boards" if views else ""), (
            "" if views else "views of a board: chessboard, ChArUco or dots"
        )
    if command == "scale":
        sources = _scale_sources(folder)
        stated = ""
        if folder.mm_per_px is not None:
            stated = f" (stated: {folder.mm_per_px[0]:g} x {folder.mm_per_px[1]:g} mm/px)"
        return ", ".join(sources), (
            ""
            if sources
            else f"a board pressed on, a known edge, balls with travel or marker pitch{stated}"
        )
    if command == "background":
        images = int(folder.background is not None) + len(folder.untouched)
        found = f"{counted(images, 'image')} of the untouched gel" if images else balls
        if folder.background is None:
            return found, "an image of the untouched gel"
        return found, _scale_for_size(folder)
    if command in ("color", "normals", "depth"):
        missing = []
        if folder.background is None:
            missing.append("an image of the untouched gel")
        if not presses:
            missing.append("ball presses")
        if presses and not folder.ball_radii_mm():
            missing.append("the ball's radius")
        if presses and folder.mm_per_px is None:
            sources = _scale_sources(folder)
            if sources:
                balls += f"; scale first, by calibrate scale ({sources[0]})"
            else:
                missing.append("the scale")
        return balls, ", ".join(missing)
    if command == "markers":
        if folder.markers is None:
            return "", "an image of the dots at rest, videos of them moving"
        videos = len(folder.markers.videos)
        if folder.markers.rest is None and not videos:
            return "an image of pressed dots", "an image of the dots at rest"
        rest = "videos show rest" if folder.markers.rest is None else "dots at rest"
        return f"{rest}, {counted(videos, 'video')}", ""
    kinds = [record.entry.kind for record in folder.records]
    if not kinds:
        return "", "force records: indentation (E)"
    return ", ".join(f"{kinds.count(kind)} x {kind}" for kind in dict.fromkeys(kinds)), ""


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
        count, total = len(found.refused), len(board.frames)
        seen = {view.name for view in found.views}
        findings.append(
            camera.BOARDS_REFUSED(
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
            findings.append(remarks.BOARD_WITHOUT_PITCH(board=what, blocks=use))
        return findings
    if len(found.views) < GOOD_VIEWS:
        findings.append(
            TOO_FEW(
                found=f"{counted(len(found.views), 'view')} of {what}",
                wanted=camera.MORE_VIEWS,
                blocks=use,
            )
        )
    points = np.concatenate([view.uv_px for view in found.views])
    width, height = found.views[0].size_px
    cells = {(int(u / width * 4), int(v / height * 4)) for u, v in points}
    if len(cells) < BOARD_COVERAGE * 16:
        findings.append(camera.LENS_COVERAGE(share=len(cells) / 16, blocks=use))
    return findings


def _check_markers(markers: MarkerCaptures) -> list[Remark]:
    findings = _check_labels(markers)
    try:
        rest = find_rest(markers)
    except InputError as fault:
        return [*findings, remarks.NO_REST_FRAME(reason=fault)]
    image = rest.frame.image()
    try:
        find_markers(image)
    except InputError as fault:
        return [remarks.NO_REST_FRAME(reason=f"{rest.frame.name} shows no grid of dots: {fault}")]
    findings += [replace(remark, blocks=("markers", "scale")) for remark in rest.remarks]
    for video in markers.videos:
        findings += _check_video(video, image)
    return findings


def _check_labels(markers: MarkerCaptures) -> list[Remark]:
    """Whether measured dots lie where the image that they were measured in shows some."""
    frame = markers.rest if markers.labels_frame is None else markers.labels_frame
    if not markers.labels or frame is None:
        return []
    try:
        near = find_markers(frame.image()).dots.uv_px
    except InputError as fault:
        return [remarks.NO_REST_FRAME(reason=f"{frame.name} shows no grid of dots: {fault}")]
    u, v, du, dv = (markers.labels[name] for name in ("u_px", "v_px", "du_px", "dv_px"))
    given = np.column_stack([u + du, v + dv])
    gap = np.linalg.norm(given[:, None] - near[None], axis=-1).min(axis=1)
    lost = int((gap > LABEL_DOT_PX).sum())
    if lost <= LABELS_LOST * len(gap):
        return []
    how = (
        f"moved by their displacements they are more than {LABEL_DOT_PX:g} px from any dot of "
        f"{frame.name} (median {np.median(gap):.1f} px)"
    )
    figures = {"wrong": lost, "count": len(gap), "advice": "Measure them again", "how": how}
    return [LABELS_OFF(labels="measured dots", blocks=("markers",), **figures)]


def _check_video(video: Video, rest: np.ndarray) -> list[Remark]:
    fault = cut_short(video)
    findings = [] if fault is None else [VIDEO_CUT_SHORT(reason=fault, blocks=("markers",))]
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
    moved = max(float(np.percentile(np.abs(image - small[0]), 99)) for image in small)
    if moved < 4.0:
        findings.append(remarks.NO_MOTION(video=video.source, count=len(small)))
    return findings


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


def _check_record(record: ForceRecord) -> list[Remark]:
    entry, columns = record.entry, record.columns
    findings = []
    if entry.tool.radius_mm is None and entry.tool.kind != "flat":
        findings.append(remarks.TOOL_UNKNOWN(record=record.source, tool=entry.tool.kind))
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
