# SPDX-License-Identifier: Apache-2.0
"""What the page of a profile, and that of a whole calibration, can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

BLOCK_UNFIT = RemarkKind("block_unfit", Severity.ERROR, "{block} {state}: {reason}")
WEAK_BLOCK = RemarkKind("weak_block", Severity.ERROR, "{block}: calibrated, but weak")
USABLE_BLOCK = RemarkKind("usable_block", Severity.WARNING, "{block}: usable, with reservations")
ASSUMED_BLOCK = RemarkKind(
    "assumed_block", Severity.WARNING, "{block}: assumed, not measured; {how}"
)
BLOCK_REMARK = RemarkKind("block_remark", Severity.INFO, "{block}: {remark}")
"""As grave as the block's own remark says."""
MISSING_BLOCK = RemarkKind(
    "missing_block",
    Severity.INFO,
    "{block}: missing, so no calibrated pictures; taccel-lab calibrate {block}",
)
QUICK_SESSION = RemarkKind(
    "quick_session",
    Severity.INFO,
    "{keys}: recorded in a quick session, which leaves out {left_out}; see Recordings",
)
BLOCKS_DROPPED = RemarkKind(
    "blocks_dropped",
    Severity.WARNING,
    "dropped from the base profile: {lost}. The profile holds for {old_width}x{old_height} px at "
    "{old_x:.4g} x {old_y:.4g} mm/px, these captures have {width}x{height} px at {x:.4g} x "
    "{y:.4g}. State the same scale, or calibrate these blocks again",
)
