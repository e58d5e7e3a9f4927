# SPDX-License-Identifier: Apache-2.0
"""The whole check of a capture folder, and what it says of one block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from taccel_lab.calibration.blocks import HOMES, block_named
from taccel_lab.calibration.capture.coverage import coverage_map, empty_cells
from taccel_lab.calibration.capture.folder import CaptureFolder, in_words
from taccel_lab.calibration.capture.sensor_facts import SensorFacts, sensor_facts
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.background import BackgroundCheck, check_background
from taccel_lab.calibration.check.ball_sizes import ball_sizes, check_diameter
from taccel_lab.calibration.check.balls import check_balls, check_scale, check_size, check_slopes
from taccel_lab.calibration.check.content import BlockStatus, block_statuses, check_content
from taccel_lab.calibration.check.frames import FrameFigures, measure_presses
from taccel_lab.calibration.check.light import check_handedness, check_light, is_grey
from taccel_lab.calibration.check.pictures import check_pictures, check_tone
from taccel_lab.calibration.check.presses import (
    check_contacts,
    found_circles,
    label_gaps,
    rejected_labels,
)
from taccel_lab.calibration.pad import design_remarks
from taccel_lab.calibration.remarks import GREY_OR_COLOUR
from taccel_lab.errors import InputError, naming
from taccel_lab.geometry import PixelGrid
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.bonded_layer import BondedLayer
from taccel_lab.reading.thumb import thumb
from taccel_lab.report.remark import Remark, Severity

ANY_SCALE_MM_PER_PX = 0.05
"""Where no scale is stated: pixels are then square and lengths are only told in pixels."""
KEEPS_VOLUME = 0.4999
"""Poisson's ratio of gels, near enough for a ball's depth in one."""
SPOILS_SLOPES = {
    "channels_swapped",
    "mixed_sensors",
    "ball_too_small",
    "background_differs",
    "median_pressed",
}
"""Faults that leave nothing to learn about the ball from colours."""
RANK = {Severity.INFO: 0, Severity.WARNING: 1, Severity.ERROR: 2}


@dataclass(frozen=True)
class PressCheck:
    """Findings of ball presses and their background, whichever block they are for."""

    findings: tuple[Remark, ...] = ()
    frames: tuple[FrameFigures, ...] = ()
    grid: PixelGrid | None = None
    """Grid of the presses; its scale is made up where none is stated."""
    background: BackgroundCheck | None = None
    grey: bool | None = None
    """Whether grey levels stand for depth; None where nothing tells."""

    @property
    def rejected_labels(self) -> frozenset[str]:
        """Presses whose labels their images reject."""
        return frozenset() if self.grid is None else rejected_labels(self.frames, self.grid)


@dataclass(frozen=True, kw_only=True)
class CaptureCheck(PressCheck):
    """What the check of one folder found, worst first, with what its presses show."""

    folder: CaptureFolder
    blocks: tuple[BlockStatus, ...]
    notes: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether nothing stops what the captures are there for."""
        return all(finding.severity != Severity.ERROR for finding in self.findings)

    def figures(self) -> dict[str, Any]:
        """Everything found, ready for JSON."""
        return {
            "source": self.folder.source,
            "sensor": self.folder.sensor,
            "usable": self.usable,
            "contents": self.folder.contents(),
            "blocks": [block.to_dict() for block in self.blocks],
            "findings": [asdict(finding) for finding in self.findings],
            "notes": list(self.notes),
            "presses": self.press_figures(),
            "coverage": self._coverage(),
        }

    def press_figures(self) -> list[dict[str, Any]]:
        """Circle, label and picture of each press, ready for JSON."""
        if self.grid is None:
            return []
        gaps = {gap.name: gap for gap in label_gaps(self.frames, self.grid)}
        rows = []
        for frame in self.frames:
            circle, gap = frame.circle, gaps.get(frame.press.name)
            rows.append(
                {
                    "name": frame.press.name,
                    "u_px": None if circle is None else circle.u_px,
                    "v_px": None if circle is None else circle.v_px,
                    "radius_px": None if circle is None else circle.radius_px,
                    "found": frame.contact is not None,
                    "fault": frame.fault,
                    "label_center_px": None if gap is None else gap.center_px,
                    "label_radius_px": None if gap is None else gap.radius_px,
                    "shift_levels": frame.shift_levels,
                    "saturated_share": frame.saturated_share,
                    "rim_px": frame.rim_px,
                    "texture": frame.texture,
                }
            )
        return rows

    def _coverage(self) -> dict[str, Any] | None:
        if self.grid is None or not self.frames:
            return None
        circles = found_circles(self.frames)
        return {
            "share": float((coverage_map(circles, self.grid) > 0).mean()),
            "empty_parts": empty_cells(circles, self.grid),
        }


def check_captures(
    folder: CaptureFolder,
    *,
    only: Sequence[str] = (),
    notes: tuple[str, ...] = (),
    progress: Progress = silent,
    fit_ball: bool = True,
) -> CaptureCheck:
    """Judge everything in a folder, or what concerns the blocks ``only``; ``notes`` are what an
    importer assumed.

    ``fit_ball`` holds the ball's radius against the slopes that colours show, which takes several
    seconds; a grey sensor shows none.

    Raises:
        InputError: A file cannot be read.
    """
    with naming(folder.source):
        facts = sensor_facts(folder.sensor, folder.design)
    blocks = tuple(block_named(name) for name in only or HOMES)
    findings = check_content(folder)
    for block in blocks:  # Two may look at the same captures.
        findings += [finding for finding in block.check(folder) if finding not in findings]
    if facts is None:
        findings.append(remarks.SENSOR_UNKNOWN(sensor=folder.sensor))
    if folder.assumed:
        findings.append(
            remarks.ASSUMED(count=len(folder.assumed), assumed=in_words(folder.assumed))
        )
    presses = folder.once.of(
        ("presses", fit_ball), lambda: _check_presses(folder, facts, progress, fit_ball)
    )
    findings += presses.findings
    targets = folder.boards or folder.edges or folder.markers or folder.records
    if folder.background is None and not folder.presses and not targets:
        findings.append(remarks.EMPTY())
    # Of equal weight, those about most images first.
    findings.sort(key=lambda finding: (-RANK[finding.severity], -len(finding.frames)))
    return CaptureCheck(
        findings=tuple(findings),
        frames=presses.frames,
        grid=presses.grid,
        background=presses.background,
        grey=presses.grey,
        folder=folder,
        blocks=tuple(block_statuses(folder, blocks, findings, grey=presses.grey)),
        notes=notes,
    )


def _check_presses(
    folder: CaptureFolder, facts: SensorFacts | None, progress: Progress, fit_ball: bool
) -> PressCheck:
    grey = None if facts is None else facts.is_grey
    if not folder.presses:
        return PressCheck(grey=grey)
    try:
        background = check_background(folder)
    except InputError as fault:
        return PressCheck((remarks.NO_BACKGROUND(instead=str(fault)),), grey=grey)
    grid = press_grid(folder, background.image)
    frames = measure_presses(
        folder.presses, background.image, folder.mask, grid, progress, "grey" if grey else None
    )
    findings = [*background.findings, *press_findings(folder, frames, background, grid, facts)]
    if grey is not True:
        grey = is_grey(frames, thumb(background.image))
    spoilt = grey or any(finding.code in SPOILS_SLOPES for finding in findings)
    if fit_ball and not spoilt:
        findings += check_slopes(folder, background.image)
    return PressCheck(tuple(findings), tuple(frames), grid, background, grey)


def press_grid(folder: CaptureFolder, image: np.ndarray) -> PixelGrid:
    """Pixels of the presses; of a made-up scale where none is stated."""
    scale = folder.mm_per_px or (ANY_SCALE_MM_PER_PX, ANY_SCALE_MM_PER_PX)
    return PixelGrid(image.shape[1], image.shape[0], *scale)


def press_findings(
    folder: CaptureFolder,
    frames: list[FrameFigures],
    background: BackgroundCheck,
    grid: PixelGrid,
    facts: SensorFacts | None,
) -> list[Remark]:
    """All that ball presses say, of their figures."""
    small = thumb(background.image)
    findings = [
        *check_light(frames, small, grid),
        *check_pictures(frames, background.image),
        *([] if background.findings else check_tone(frames)),
        *check_contacts(frames, grid),
        *_ball_findings(folder, frames, grid, None if facts is None else facts.thickness_mm),
    ]
    if facts is None:
        return findings
    findings += check_handedness(frames, small, facts.family, facts.handedness)
    assumed = design_remarks(
        facts.family, None if folder.mm_per_px is None else grid, folder.design
    )
    findings += [replace(remark, blocks=("color", "normals", "depth")) for remark in assumed]
    size = (grid.width_px, grid.height_px)
    if facts.image_px is not None:
        findings += check_size(size, facts.image_px, facts.family)
    if folder.mm_per_px is not None:
        findings += check_scale(grid, folder.mask, facts, folder.design)
    grey = is_grey(frames, small)
    if grey is not None and grey != facts.is_grey and facts.family != "flat_pad":
        have, want = ("grey", "coloured") if grey else ("coloured", "grey")
        findings.append(
            GREY_OR_COLOUR(found=have, expected=want, blocks=("color", "normals", "depth"))
        )
    return findings


def _ball_findings(
    folder: CaptureFolder, frames: list[FrameFigures], grid: PixelGrid, thickness_mm: float | None
) -> list[Remark]:
    """Findings on the ball's radius; where none contradicts it, whether it may be its diameter."""
    stated = grid if folder.mm_per_px is not None else None
    found = check_balls(frames, stated, folder.ball_radius_mm, thickness_mm)
    if found or stated is None or folder.ball_radius_mm is None or folder.by_diameter:
        return found
    thickness_mm = folder.design.get("thickness_mm", thickness_mm)
    layer = None if thickness_mm is None else BondedLayer(thickness_mm, KEEPS_VOLUME)
    return check_diameter(frames, ball_sizes(frames, stated, folder.ball_radius_mm), layer)


def capture_findings(
    folder: CaptureFolder, block: str, progress: Progress = silent
) -> list[Remark]:
    """Findings of ``taccel-lab capture check`` that name ``block``, worst first; captures of other
    blocks are not looked at.

    A fit to captures that contradict themselves can leave small residuals: the check holds them
    against the ball, the sensor and each other.
    """
    found = capture_check(folder, progress, (block,))
    return [finding for finding in found.findings if block in finding.blocks]


def capture_check(
    folder: CaptureFolder, progress: Progress = silent, only: Sequence[str] = ()
) -> CaptureCheck:
    """The check of ``folder`` for the blocks ``only``, or for all, made once of its captures."""
    return folder.once.of(
        ("check", tuple(only)), lambda: check_captures(folder, only=only, progress=progress)
    )


@contextmanager
def refusing_with(findings: Sequence[Remark]) -> Iterator[None]:
    """A refusal inside names what the check found as well: the cause may be among it. Remarks that
    concern no block say nothing of the captures and are passed over."""
    try:
        yield
    except InputError as fault:
        also = [
            f"- {finding.message}"
            for finding in findings
            if finding.blocks and finding.severity != Severity.INFO and finding.code != "no_contact"
        ]
        heading = ["the captures have more faults:"] if also else []
        raise InputError("\n".join([str(fault), *heading, *also])) from None


def joined(findings: Sequence[Remark], remarks: Sequence[Remark]) -> tuple[Remark, ...]:
    """Findings, then remarks of the fit; where both say one thing, by its code, the graver does."""
    said = {finding.code: RANK[finding.severity] for finding in findings}
    graver = [remark for remark in remarks if RANK[remark.severity] > said.get(remark.code, -1)]
    codes = {remark.code for remark in graver}
    return (*(finding for finding in findings if finding.code not in codes), *graver)
