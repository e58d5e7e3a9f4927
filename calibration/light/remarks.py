# SPDX-License-Identifier: Apache-2.0
"""What the comparison of the light of several frames can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import warning

LIGHT_DRIFTS = warning(
    "light_drifts",
    "over {frame_count} frames the untouched gel changes by {changes} levels (standard deviation), "
    "at most {largest:.0f}. {cause}",
)
