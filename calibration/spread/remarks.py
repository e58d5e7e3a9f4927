# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the spread can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

FEW_FRAMES = RemarkKind(
    "few_frames",
    Severity.WARNING,
    "{count} {what}: each standard deviation is itself uncertain by {error:.0%}; {enough} or more "
    "would halve that",
)
