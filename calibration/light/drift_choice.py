# SPDX-License-Identifier: Apache-2.0
"""Whether the light's drift is taken off the frames: where that brings untouched gel much nearer.

Where it hardly matters, leaving it in averages the light over all captures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

DriftMode = Literal["auto", "on", "off"]
NEEDED_GAIN = 0.25
"""Share of the difference between untouched gel and background that ``auto`` has to take away: it
does 59 % of it on frames with automatic white balance, 4 and 14 % on two sets with fixed
settings."""


@dataclass(frozen=True)
class DriftChoice:
    """What was chosen, and the differences that it rests on."""

    remove: bool
    captured_levels: float
    """Mean difference of untouched gel from the background, median over the frames [levels]."""
    corrected_levels: float
    """The same with the drift of each frame taken off [levels]."""

    @classmethod
    def of(
        cls, differences: Sequence[tuple[float, float]], mode: DriftMode = "auto"
    ) -> DriftChoice:
        """From the differences [levels] of each frame, as captured and with its drift taken off;
        ``on`` and ``off`` decide themselves."""
        captured, corrected = (float(levels) for levels in np.median(differences, axis=0))
        pays = corrected < (1 - NEEDED_GAIN) * captured
        return cls(mode == "on" or (mode == "auto" and pays), captured, corrected)
