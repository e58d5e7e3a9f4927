# SPDX-License-Identifier: Apache-2.0
"""Contents of a folder for each block, what is missing, and which command that stops."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from taccel_lab.calibration.block import Block
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.check.remarks import BALL_RADIUS_UNSTATED, SCALE_UNSTATED
from taccel_lab.calibration.needs import scale_sources
from taccel_lab.report.remark import Remark, Severity


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
        findings.append(BALL_RADIUS_UNSTATED())
    if folder.presses and folder.mm_per_px is None and not scale_sources(folder):
        findings.append(SCALE_UNSTATED())
    return findings


def block_statuses(
    folder: CaptureFolder,
    blocks: Iterable[Block],
    findings: Sequence[Remark],
    *,
    grey: bool | None = None,
) -> list[BlockStatus]:
    """Readiness of the commands of ``blocks``; ``grey`` says that grey levels stand for depth."""
    statuses = []
    for block in blocks:
        found, missing = block.needs(folder, grey)
        mine = {finding.severity for finding in findings if block.name in finding.blocks}
        if not found:
            readiness = Readiness.ABSENT
        elif missing or Severity.ERROR in mine:
            readiness = Readiness.BLOCKED
        else:
            readiness = Readiness.WEAK if Severity.WARNING in mine else Readiness.READY
        statuses.append(BlockStatus(block.name, readiness, found, missing))
    return statuses
