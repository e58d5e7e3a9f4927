# SPDX-License-Identifier: Apache-2.0
"""From linear light to the 8-bit image that a camera would deliver: gains per channel and gamma."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from taccel_lab.errors import InputError

WhiteBalance = Literal["gray", "none"]


@dataclass(frozen=True)
class Display:
    """Exposure, white balance and gamma, fixed once for all frames of a sensor."""

    gains: tuple[float, float, float]
    """Factor by channel before gamma; full scale is 1."""
    gamma: float = 2.2

    def levels(self, linear: np.ndarray) -> np.ndarray:
        """Grey levels 0 to 255 before rounding and clipping, [..., 3] -> [..., 3]."""
        scaled = np.maximum(np.asarray(linear) * np.array(self.gains, dtype=np.float32), 0.0)
        return 255.0 * scaled ** (1.0 / self.gamma)

    def rgb(self, linear: np.ndarray) -> np.ndarray:
        """8-bit RGB, [..., 3] -> uint8 [..., 3]."""
        return np.clip(np.rint(self.levels(linear)), 0, 255).astype(np.uint8)

    def levels_per_radiance(self, linear: np.ndarray) -> np.ndarray:
        """Derivative of ``levels``, [..., 3] -> [..., 3]; 0 where there is no light."""
        linear = np.asarray(linear, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = self.levels(linear) / (self.gamma * linear)
        return np.where(linear > 0, slope, 0.0)


def exposed(
    linear: np.ndarray,
    mask: np.ndarray,
    *,
    level: float | tuple[float, float, float] = 110.0,
    gamma: float = 2.2,
    white_balance: WhiteBalance = "gray",
) -> Display:
    """Display that gives the background's median a wanted grey level.

    Args:
        linear: Radiance of the untouched gel, shape [H, W, 3].
        mask: Pixels that count, shape [H, W].
        level: Wanted median, 1 to 254, or one for each channel, such as those of a real sensor.
        gamma: Exponent of the camera's response.
        white_balance: gray exposes each channel by itself; none keeps the ratios of the channels
            and exposes the brightest.
    """
    levels = np.broadcast_to(np.asarray(level, dtype=np.float64), (3,))
    if not ((levels >= 1) & (levels <= 254)).all():
        raise InputError(f"the exposure level must lie in [1, 254], got {level}")
    if not 0.5 <= gamma <= 4:
        raise InputError(f"gamma must lie in [0.5, 4], got {gamma}")
    if not mask.any():
        raise InputError("no pixel of the camera sees the gel's contact face")
    medians = np.median(linear[mask], axis=0).astype(np.float64)
    if medians.max() <= 0:
        raise InputError("no light reaches the gel that the camera sees")
    common = np.full(3, medians.max())
    # A channel that no light feeds stays dark.
    reference = np.where(medians > 0, medians, common) if white_balance == "gray" else common
    r, g, b = ((levels / 255.0) ** gamma / reference).tolist()
    return Display((r, g, b), gamma)
