# SPDX-License-Identifier: Apache-2.0
"""A measured scale against the one that the captures state."""

from __future__ import annotations

from collections.abc import Mapping

from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.result import Estimate, Remark, Severity

STATED_SIGMAS, STATED_SHARE = 3.0, 0.02
"""A stated scale differs when it is off by this many standard deviations and by this share."""


def stated_scale_remarks(folder: CaptureFolder, measured: Mapping[str, Estimate]) -> list[Remark]:
    """Warnings where ``measured`` (mm/px by axis, ``x`` and ``y``) is not what captures state."""
    remarks = []
    for axis, found in measured.items():
        stated = None if folder.mm_per_px is None else folder.mm_per_px["xy".index(axis)]
        if stated is None:
            continue
        off = stated - found.value
        if abs(off) > max(STATED_SIGMAS * found.sigma, STATED_SHARE * stated):
            remarks.append(
                Remark(
                    Severity.WARNING,
                    "stated_scale_differs",
                    f"the captures state mm_per_px_{axis} = {stated:g}, measured is {found}: "
                    f"{off / found.value:+.1%}",
                )
            )
    return remarks
