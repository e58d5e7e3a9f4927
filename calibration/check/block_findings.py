# SPDX-License-Identifier: Apache-2.0
"""What the check of the captures says of one block, for its verdict and its refusals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.check.findings import Finding
from taccel_lab.calibration.check.run import CaptureCheck, check_captures
from taccel_lab.calibration.result import Remark, Severity
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent

TASK = "checking the captures"
RANK = {Severity.INFO: 0, Severity.WARNING: 1, Severity.ERROR: 2}


_shared: ContextVar[dict[tuple[str, ...], CaptureCheck] | None] = ContextVar("shared", default=None)


@contextmanager
def shared_checks() -> Iterator[None]:
    """Calibrations that run inside check the same captures once."""
    token = _shared.set({})
    try:
        yield
    finally:
        _shared.reset(token)


def capture_findings(
    folder: CaptureFolder, block: str, progress: Progress = silent
) -> list[Finding]:
    """Findings of ``taccel-lab capture check`` that name ``block``, worst first.

    A fit to captures that contradict themselves can leave small residuals: the check holds them
    against the ball, the sensor and each other.
    """
    # A grey sensor has no slopes by colour to hold the ball against.
    found = capture_check(folder, progress, fit_ball=block != "depth")
    return [finding for finding in found.findings if block in finding.blocks]


def capture_check(
    folder: CaptureFolder, progress: Progress = silent, *, fit_ball: bool = True
) -> CaptureCheck:
    """``taccel-lab capture check``; inside ``shared_checks`` the one that was made of the folder.

    One that has the ball fitted serves those that do not ask for it: what it says more is of other
    blocks.
    """
    shared = _shared.get()
    frames = (*folder.presses, *folder.untouched)
    key = (folder.source, *folder.provenance.values(), *(frame.sha256 for frame in frames))
    if shared is not None and key in shared:
        return shared[key]
    found = check_captures(
        folder, progress=lambda done, total: progress(TASK, done, total), fit_ball=fit_ball
    )
    if shared is not None and fit_ball:
        shared[key] = found
    return found


@contextmanager
def refusing_with(findings: Sequence[Remark]) -> Iterator[None]:
    """A refusal inside names what the check found as well: the cause may be among it. Remarks that
    are no findings say nothing of the captures and are passed over."""
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


def joined(findings: Sequence[Remark], remarks: Sequence[Remark]) -> tuple[Remark, ...]:
    """Findings, then remarks of the fit; where both have one thing to say, the graver one does."""
    said = {finding.code: RANK[finding.severity] for finding in findings}
    graver = [remark for remark in remarks if RANK[remark.severity] > said.get(remark.code, -1)]
    codes = {remark.code for remark in graver}
    return (*(finding for finding in findings if finding.code not in codes), *graver)
