# SPDX-License-Identifier: Apache-2.0
"""What the comparison of the light of several frames can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

CHANNELS_DRIFT = RemarkKind(
    "channels_drift",
    Severity.WARNING,
    "the channels drift apart: over {frame_count} frames the untouched gel changes by {changes} "
    "levels (standard deviation), at most {largest:.0f}. The camera's automatic white balance (or "
    "exposure a channel) was on: switch it off. Colours and normals take it off each frame where "
    "that brings untouched gel nearer to the background, and say so (--drift)",
)
LIGHT_DRIFTS = RemarkKind(
    "light_drifts",
    Severity.WARNING,
    "the light drifts: over {frame_count} frames the untouched gel changes by {changes} levels "
    "(standard deviation), at most {largest:.0f}. Let lamps warm up, and record the background "
    "right before the presses. Colours and normals take it off each frame where that brings "
    "untouched gel nearer to the background, and say so (--drift)",
)
LIGHT_STEADY = RemarkKind(
    "light_steady",
    Severity.INFO,
    "the light is steady: over {frame_count} frames the untouched gel changes by {changes} levels "
    "(standard deviation), at most {largest:.0f}",
)
