# SPDX-License-Identifier: Apache-2.0
"""Contacts that were found in images, with what speaks for each, and why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.errors import InputError


@dataclass(frozen=True)
class DetectedContact:
    """A contact found in an image, with what speaks for it."""

    circle: ContactCircle
    radius_sigma_px: float
    """Standard deviation of the radius."""
    contrast_levels: float
    """90th percentile of the smoothed colour change in the contact [levels]."""
    center_sigma_px: float = 0.0
    """Standard deviation of the centre along an axis."""
    explained: float = 1.0
    """Share of the colour change that the ball's slope explains."""
    visible: float = 1.0
    """Share of the contact and its surroundings that lies in the image and outside the mask."""

    @property
    def confidence(self) -> float:
        """0..1: explained share times visible share, less the more uncertain the circle is."""
        sigma = np.hypot(self.center_sigma_px, self.radius_sigma_px)
        doubt = 1 + (sigma / (0.08 * self.circle.radius_px)) ** 2
        return float(np.clip(self.explained, 0, 1) * min(1.0, self.visible) / doubt)


class UntouchedError(InputError):
    """An image in which no change of colour stands out from the noise: nothing touches the gel."""


class CutContactError(InputError):
    """A contact that reaches out of the image, or is mostly masked: no fault of the captures."""


def circle_array(circles: Sequence[ContactCircle]) -> np.ndarray:
    """u, v and radius of each circle [px], shape [n, 3]."""
    return np.array([(c.u_px, c.v_px, c.radius_px) for c in circles]).reshape(-1, 3)


def circle_of(shape: np.ndarray) -> ContactCircle:
    """The circle of u, v and radius [px], shape [3]."""
    return ContactCircle(*(float(x) for x in shape))
