# SPDX-License-Identifier: Apache-2.0
"""What the check of the captures says of one block, for its verdict and its refusals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.check.run import CaptureCheck, check_captures
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark, Severity

RANK = {Severity.INFO: 0, Severity.WARNING: 1, Severity.ERROR: 2}


def capture_findings(
    folder: CaptureFolder, block: str, progress: Progress = silent
) -> list[Remark]:
    """Findings of ``taccel-lab capture check`` that name ``block``, worst first.

    A fit to captures that contradict themselves can leave small residuals: the check holds them
    against the ball, the sensor and each other.
    """
    found = capture_check(folder, progress)
    return [finding for finding in found.findings if block in finding.blocks]


def capture_check(folder: CaptureFolder, progress: Progress = silent) -> CaptureCheck:
    """The check of ``folder``, which its blocks share."""
    return folder.once.of("check", lambda: check_captures(folder, progress=progress))


def rejected_labels(folder: CaptureFolder, progress: Progress = silent) -> frozenset[str]:
    """Presses of ``folder`` whose labels their images reject."""
    return capture_check(folder, progress).rejected_labels


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
    """Findings, then remarks of the fit; where both have one thing to say, the graver one does.

    A remark says what a finding says when it has its code, or that with the block before it:
    ``normals_few_presses`` goes with ``few_presses``.
    """
    said = {code: RANK[finding.severity] for finding in findings for code in _codes(finding)}
    graver = [remark for remark in remarks if RANK[remark.severity] > said.get(remark.code, -1)]
    codes = {remark.code for remark in graver}
    return (*(finding for finding in findings if not _codes(finding) & codes), *graver)


def _codes(finding: Remark) -> set[str]:
    return {finding.code, *(f"{block}_{finding.code}" for block in finding.blocks)}
