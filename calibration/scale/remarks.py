# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the scale can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import error, warning

# What each method finds.
METHOD_FAILED = warning("method_failed", "no scale from {method}: {reason}")

# What they say together.
CONTACTS_EXCEED_BALL = error(
    "contacts_exceed_ball",
    "contacts of the ball are larger than the ball at {scale}: at most {limit:.5f} mm/px would "
    "fit. The ball's radius is stated too small (a diameter is no radius), or the scale is wrong",
)
SCALE_UNSURE = error(
    "scale_unsure",
    "the scale along {axis} is known to {share:.0%} only; add a board on the gel, an edge or "
    "markers of known pitch",
)
