# SPDX-License-Identifier: Apache-2.0
"""What the page of a profile, and that of a whole calibration, can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import warning
from taccel_lab.report.remark import Severity

BLOCK_STATE = warning("block_state", "{block}: calibrated, but {what}", graver=Severity.ERROR)
BLOCK = warning("block", "{block}: {what}", graver=Severity.ERROR)
"""Why a block is not calibrated, or what its own remark says, as grave as that."""
BLOCKS_DROPPED = warning(
    "blocks_dropped",
    "dropped from the base profile: {lost}. The profile holds for {old_width}x{old_height} px at "
    "{old_x:.4g} x {old_y:.4g} mm/px, these captures have {width}x{height} px at {x:.4g} x "
    "{y:.4g}. State the same scale, or calibrate these blocks again",
)
