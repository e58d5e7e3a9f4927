# SPDX-License-Identifier: Apache-2.0
"""What the check of the captures says of a command's block, for its report and its verdict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture import CaptureFolder
    from taccel_lab.calibration.check import Finding
    from taccel_lab.calibration.check.run import CaptureCheck
    from taccel_lab.calibration.result import Remark
    from taccel_lab.profile import SensorProfile


def capture_findings(folder: CaptureFolder, command: str, console: Console) -> list[Finding]:
    """Findings of ``taccel-lab capture check`` that name ``command``, worst first.

    A fit to captures that contradict themselves can leave small residuals: the check holds them
    against the ball, the sensor and each other.
    """
    # A grey sensor has no slopes by colour to hold the ball against.
    found = capture_check(folder, console, fit_ball=command != "depth")
    return [finding for finding in found.findings if command in finding.blocks]


_shared: ContextVar[dict[tuple[str, ...], CaptureCheck] | None] = ContextVar("shared", default=None)


@contextmanager
def shared_checks() -> Iterator[None]:
    """Commands that run inside check the same captures once."""
    token = _shared.set({})
    try:
        yield
    finally:
        _shared.reset(token)


def capture_check(
    folder: CaptureFolder, console: Console, *, fit_ball: bool = True
) -> CaptureCheck:
    """``taccel-lab capture check``; inside ``shared_checks`` the one that was made of the folder.

    One that has the ball fitted serves those that do not ask for it: what it says more is of other
    blocks.
    """
    from taccel_lab.calibration.check import check_captures
    from taccel_lab.cli.progress import count_progress

    shared = _shared.get()
    frames = (*folder.presses, *folder.untouched)
    key = (folder.source, *folder.provenance.values(), *(frame.sha256 for frame in frames))
    if shared is not None and key in shared:
        return shared[key]
    with count_progress(console, "checking the captures") as progress:
        found = check_captures(folder, progress=progress, fit_ball=fit_ball)
    if shared is not None and fit_ball:
        shared[key] = found
    return found


def lost_blocks(before: SensorProfile, after: SensorProfile) -> list[Remark]:
    """Blocks of the profile to extend that do not go with the captures' image size and scale."""
    from taccel_lab.calibration.result import Remark, Severity

    lost = [key for key in before.blocks() if key not in after.blocks()]
    if not lost:
        return []
    old, new = before.grid(), after.grid()
    return [
        Remark(
            Severity.WARNING,
            "blocks_dropped",
            f"the base profile's {', '.join(lost)} went: they are of {old.width_px}x{old.height_px}"
            f" px at {old.mm_per_px_x:.4g} x {old.mm_per_px_y:.4g} mm/px, these captures of "
            f"{new.width_px}x{new.height_px} px at {new.mm_per_px_x:.4g} x {new.mm_per_px_y:.4g}. "
            "State the same scale, or calibrate these blocks again",
        )
    ]


@contextmanager
def refusing_with(findings: Sequence[Remark]) -> Iterator[None]:
    """A refusal inside names what the check found as well: the cause may be among it. Remarks that
    are no findings say nothing of the captures and are passed over."""
    from taccel_lab.calibration.check import Finding
    from taccel_lab.calibration.result import Severity

    try:
        yield
    except InputError as fault:
        also = [
            f"- {finding.message}"
            for finding in findings
            if isinstance(finding, Finding)
            and finding.severity != Severity.INFO
            and finding.code != "no_contact"
        ]
        heading = ["the captures have more faults:"] if also else []
        raise InputError("\n".join([str(fault), *heading, *also])) from None


def joined(findings: Sequence[Finding], remarks: Sequence[Remark]) -> tuple[Remark, ...]:
    """Findings, then remarks of the fit; where both have one thing to say, the graver one does."""
    from taccel_lab.calibration.result import Severity

    rank = {Severity.INFO: 0, Severity.WARNING: 1, Severity.ERROR: 2}
    said = {finding.code: rank[finding.severity] for finding in findings}
    graver = [remark for remark in remarks if rank[remark.severity] > said.get(remark.code, -1)]
    codes = {remark.code for remark in graver}
    return (*(finding for finding in findings if finding.code not in codes), *graver)
