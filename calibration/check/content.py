# SPDX-License-Identifier: Apache-2.0
"""What a folder holds for each block, what is missing, and which command that stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from taccel_lab.calibration.blocks import BLOCKS
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.check import remarks
from taccel_lab.printable import counted
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.sensors.registry import known_sensor


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
