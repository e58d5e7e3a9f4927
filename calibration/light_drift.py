# SPDX-License-Identifier: Apache-2.0
"""Change of the light over the frames of a capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.remarks import LIGHT_DRIFTS
from taccel_lab.reading.light import LightDrift, triple
from taccel_lab.report.remark import Remark

NOTABLE_LEVELS = 2.0
"""Spread of the light over the frames above which a correction pays."""
BALANCE_LEVELS = 2.5
"""Spread of the differences between channels that a free white balance leaves at least."""
BALANCE_SHARE = 0.5
"""Part of the whole spread that differences between channels have to be."""
CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True)
class DriftSpread:
    """Change of the light over a set of frames, at the background's mean level."""

    frame_count: int
    shift_levels: tuple[float, float, float]
    """Standard deviation over the frames of each channel's change [levels]."""
    largest_levels: float
    """Largest change of any channel in any frame [levels]."""
    mean_shift_levels: tuple[float, float, float]
    """Mean change of each channel against the background [levels]."""
    gradient_levels: float
    """Root mean square of the gradients, centre to border [levels]."""
    balance_levels: float
    """Standard deviation of the channels' changes about their common one [levels]."""

    @property
    def auto_white_balance(self) -> bool:
        """Channels moved apart from each other, by more than noise and lamps explain."""
        whole = float(np.sqrt(np.mean(np.square(self.shift_levels))))
        return self.balance_levels > BALANCE_LEVELS and self.balance_levels > BALANCE_SHARE * whole


def drift_spread(drifts: Sequence[LightDrift], background: np.ndarray) -> DriftSpread:
    """Spread of ``drifts`` of frames against ``background``, RGB levels [height, width, 3]."""
    level = background.reshape(-1, 3).astype(np.float64).mean(axis=0)
    shift = np.array([drift.shift(level) for drift in drifts])
    gradient = np.array([drift.gradient for drift in drifts])
    common = shift.mean(axis=1, keepdims=True)
    apart = shift - common
    spread = shift.std(axis=0, ddof=1) if len(shift) > 1 else np.zeros(3)
    balance = apart.std(axis=0, ddof=1) if len(shift) > 1 else np.zeros(3)
    return DriftSpread(
        frame_count=len(drifts),
        shift_levels=triple(spread),
        largest_levels=float(np.abs(shift).max()),
        mean_shift_levels=triple(shift.mean(axis=0)),
        gradient_levels=float(np.sqrt(np.mean(gradient**2))),
        balance_levels=float(np.sqrt(np.mean(balance**2))),
    )


def drift_remarks(drifts: Sequence[LightDrift], background: np.ndarray) -> list[Remark]:
    """A remark on the drift over the frames, with figures and what to do; none where it is small.

    Colours and normals take the light off each frame where that helps.
    """
    found = drift_spread(drifts, background)
    changes = ", ".join(
        f"{name} {value:.1f}" for name, value in zip(CHANNELS, found.shift_levels, strict=True)
    )
    whole = max(found.shift_levels)
    if found.auto_white_balance:
        cause = "The channels drift apart: switch the camera's automatic white balance off"
    elif whole > NOTABLE_LEVELS or max(map(abs, found.mean_shift_levels)) > 2 * NOTABLE_LEVELS:
        cause = "Let lamps warm up, and record the background right before the presses"
    else:
        return []
    count, largest = found.frame_count, found.largest_levels
    return [LIGHT_DRIFTS(frame_count=count, changes=changes, largest=largest, cause=cause)]
