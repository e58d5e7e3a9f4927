# SPDX-License-Identifier: Apache-2.0
"""Remarks of the calibration of the background."""

from __future__ import annotations

from taccel_lab.calibration.remarks import warning

NO_UNTOUCHED_IMAGE = warning(
    "no_untouched_image",
    "no image of the untouched sensor: the background is the median of {count} presses; what they "
    "all touch is wrong. Record one",
)
BACKGROUND_CLIPPED = warning(
    "background_clipped",
    "{clipped:.0%} of the background's pixels are at 0 or 255 in a channel: their change cannot be "
    "read. Change the exposure",
)
NEW_DUST = warning(
    "new_dust",
    "{specks} specks lie in the later frames and not in the background image: the gel has "
    "collected dust since. Clean it, or record a new background",
)
