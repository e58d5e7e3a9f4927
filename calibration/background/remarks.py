# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the background can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

NO_UNTOUCHED_IMAGE = RemarkKind(
    "no_untouched_image",
    Severity.WARNING,
    "no image of the untouched sensor: the background is the median of {count} presses; what they "
    "all touch is wrong. Record one",
)
BACKGROUND_CLIPPED = RemarkKind(
    "background_clipped",
    Severity.WARNING,
    "{clipped:.0%} of the background's pixels are at 0 or 255 in a channel: their change cannot be "
    "read. Change the exposure",
)
NEW_DUST = RemarkKind(
    "new_dust",
    Severity.WARNING,
    "{specks} specks lie in the later frames and not in the background image: the gel has "
    "collected dust since. Clean it, or record a new background",
)
