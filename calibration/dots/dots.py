# SPDX-License-Identifier: Apache-2.0
"""Dots found in one picture."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np

from taccel_lab.calibration.dots.blobs import DotScale


class DotFlag(IntFlag):
    """What is special about a dot; its centre is given nonetheless."""

    CUT = 1
    """Part of it lies outside the image: shape and size are taken from its neighbours."""
    MERGED = 2
    """It touched another dot and was split from it."""
    ODD = 4
    """Its size, shape or contrast is far from the others': perhaps no dot."""


@dataclass(frozen=True)
class Dots:
    """Centres of dots with their uncertainty."""

    uv_px: np.ndarray
    """Centres (u, v) [px], float64, shape [dot, 2]."""
    covariance_px2: np.ndarray
    """Of the centres, shape [dot, 2, 2]."""
    axes_px: np.ndarray
    """Longer and shorter semi-axis, shape [dot, 2]."""
    contrast: np.ndarray
    """Share of the light that the paint adds, negative for dark dots, shape [dot]."""
    seen: np.ndarray
    """Share of each dot that is in the image, shape [dot]."""
    flags: np.ndarray
    """``DotFlag``s, uint8, shape [dot]."""
    parameters: np.ndarray
    """Parameters of ``dot_model``, shape [dot, 10]."""
    scale: DotScale
    size_px: tuple[int, int]
    """Width and height of the image."""

    @property
    def count(self) -> int:
        return len(self.uv_px)

    @property
    def sigma_px(self) -> np.ndarray:
        """Standard deviations of the centres along u and v, shape [dot, 2]."""
        return np.sqrt(np.einsum("nii->ni", self.covariance_px2))

    @property
    def radius_px(self) -> np.ndarray:
        """Mean radii, shape [dot]."""
        return np.sqrt(self.axes_px.prod(axis=1))

    @property
    def whole(self) -> np.ndarray:
        """Dots that nothing is special about, bool, shape [dot]."""
        return self.flags == 0

    def flagged(self, flag: DotFlag) -> np.ndarray:
        """Dots that carry a flag, bool, shape [dot]."""
        return (self.flags & flag) != 0

    def select(self, which: np.ndarray) -> Dots:
        """Some of the dots, in the order of ``which``."""
        return Dots(
            self.uv_px[which],
            self.covariance_px2[which],
            self.axes_px[which],
            self.contrast[which],
            self.seen[which],
            self.flags[which],
            self.parameters[which],
            self.scale,
            self.size_px,
        )
