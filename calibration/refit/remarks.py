# SPDX-License-Identifier: Apache-2.0
"""What the refit of a profile to the light of today can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

ROUGH_RESPONSE = RemarkKind(
    "rough_response",
    Severity.WARNING,
    "the frames disagree by {percent:.0f} % on the response of {channel}: more presses, in "
    "steadier light, would tell it better",
)
SOME_WORSE = RemarkKind(
    "some_worse",
    Severity.WARNING,
    "{names} fits worse than before when it is left out: the light changes between the new frames, "
    "or a press is off",
)
LIGHT_UNSTEADY = RemarkKind(
    "light_unsteady",
    Severity.WARNING,
    "the light of the new frames differs by {levels:.1f} levels among themselves: one correction "
    "cannot follow. Fix exposure and white balance",
)
