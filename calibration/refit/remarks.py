# SPDX-License-Identifier: Apache-2.0
"""Remarks of a refit."""

from __future__ import annotations

from taccel_lab.calibration.remarks import warning

ROUGH_RESPONSE = warning(
    "rough_response",
    "the frames disagree by {percent:.0f} % on the response of {channel}: more presses, in "
    "steadier light, would tell it better",
)
SOME_WORSE = warning(
    "some_worse",
    "{names} fits worse than before when it is left out: the light changes between the new frames, "
    "or a press is off",
)
LIGHT_UNSTEADY = warning(
    "light_unsteady",
    "the light of the new frames differs by {levels:.1f} levels among themselves: one correction "
    "cannot follow. Fix exposure and white balance",
)
