# SPDX-License-Identifier: Apache-2.0
"""Where a press is by its label alone, as the labels of other presses lie against the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import EQUATOR_SLACK, ContactCircle, Press

SLOPE_PRIOR = 2.0
"""Presses that the line of the radii counts a slope of one as."""


@dataclass(frozen=True)
class LabelPlacement:
    """How labels lie against where the training presses were placed.

    Centres are moved by the mean shift. Radii follow the straight line through the training
    presses: labels of radii hold errors that placed radii do not, so that a large label is likely
    too large (regression to the mean; W. A. Fuller, Measurement Error Models, 1987, section 1.1).
    """

    mean_px: np.ndarray
    """Mean of placed minus label: u, v, radius [px], shape [3]."""
    radius_slope: float
    """Of placed over label radius, drawn to one by ``SLOPE_PRIOR`` presses."""
    mean_radius_px: float
    """Mean radius of the labels, about which the line turns."""
    deviation_px: np.ndarray
    """Standard deviation over the training presses, which a placement by label is off by, [3]."""
    count: int

    @classmethod
    def of(cls, presses: Sequence[Press], placed: Sequence[ContactCircle]) -> LabelPlacement:
        """From the training presses and where they were placed, those with labels."""
        pairs = [
            ((g.u_px, g.v_px, g.radius_px), (c.u_px, c.v_px, c.radius_px))
            for press, c in zip(presses, placed, strict=True)
            if (g := press.circle) is not None
        ]
        if not pairs:
            return cls(np.zeros(3), 1.0, 0.0, np.zeros(3), 0)
        labels, found = (np.array(values) for values in zip(*pairs, strict=True))
        count, middle = len(labels), labels.mean(axis=0)
        mean = found.mean(axis=0) - middle
        label_r, found_r = labels[:, 2] - middle[2], found[:, 2] - found[:, 2].mean()
        variance = label_r @ label_r
        prior = SLOPE_PRIOR * variance / count
        slope = float((label_r @ found_r + prior) / (variance + prior)) if variance > 0 else 1.0
        left = found - labels - mean
        left[:, 2] = found_r - slope * label_r
        spread = left.std(axis=0, ddof=1) if count > 1 else np.zeros(3)
        return cls(mean, slope, float(middle[2]), spread, count)

    def applied(self, label: ContactCircle, ball_px: float) -> ContactCircle:
        """Where a press with this label is taken to be, no larger than the ball."""
        radius_px = label.radius_px
        if self.count:
            from_middle = label.radius_px - self.mean_radius_px
            radius_px = self.mean_radius_px + float(self.mean_px[2])
            radius_px += self.radius_slope * from_middle
        return ContactCircle(
            label.u_px + float(self.mean_px[0]),
            label.v_px + float(self.mean_px[1]),
            float(np.clip(radius_px, 3.0, EQUATOR_SLACK * ball_px)),
        )
