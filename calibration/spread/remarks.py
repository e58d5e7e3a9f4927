# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the spread can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

FEW_FRAMES = RemarkKind(
    "few_frames",
    Severity.WARNING,
    "{count} frames: each standard deviation is itself uncertain by {error:.0%}; {enough} or more "
    "frames would halve that",
)
FEW_UNITS = RemarkKind(
    "few_units",
    Severity.WARNING,
    "{count} units: each standard deviation is itself uncertain by {error:.0%}; {enough} or more "
    "units would halve that",
)
NO_UNITS = RemarkKind(
    "no_units",
    Severity.INFO,
    "one unit: scale, position, modulus and friction are not perturbed; give profiles of other "
    "units of this design",
)
