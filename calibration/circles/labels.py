# SPDX-License-Identifier: Apache-2.0
"""Given contact circles against found ones, and where a press is by its label alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import (
    EQUATOR_SLACK,
    CapturedPress,
    CaptureSet,
    ContactCircle,
)
from taccel_lab.calibration.circles.circle_arrays import circle_array
from taccel_lab.calibration.circles.result import DetectedContact

SLOPE_PRIOR = 2.0
"""Presses that the line of the radii counts a slope of one as."""


@dataclass(frozen=True)
class LabelAgreement:
    """Detected against given contact circles, errors over the labelled presses [px]."""

    count: int
    center_median_px: float
    center_p90_px: float
    radius_median_px: float
    """Median of the absolute difference of the radii."""
    radius_p90_px: float
    radius_bias_px: float
    """Median of detected minus given radius."""
    shift_u_px: float = 0.0
    """Median of detected minus given column: labels that all lie to one side."""
    shift_v_px: float = 0.0
    center_median_shifted_px: float = 0.0
    """Median distance of the centres once that shift is taken off."""


def agreement(
    given: Sequence[ContactCircle | None], found: Sequence[ContactCircle | None]
) -> LabelAgreement | None:
    """Agreement over the presses that have both circles; None when none has."""
    pairs = [(a, b) for a, b in zip(given, found, strict=True) if a is not None and b is not None]
    if not pairs:
        return None
    difference = circle_array([b for _, b in pairs]) - circle_array([a for a, _ in pairs])
    center = np.hypot(difference[:, 0], difference[:, 1])
    shift = np.median(difference[:, :2], axis=0)
    size = np.abs(difference[:, 2])
    return LabelAgreement(
        count=len(difference),
        center_median_px=float(np.median(center)),
        center_p90_px=float(np.percentile(center, 90)),
        radius_median_px=float(np.median(size)),
        radius_p90_px=float(np.percentile(size, 90)),
        radius_bias_px=float(np.median(difference[:, 2])),
        shift_u_px=float(shift[0]),
        shift_v_px=float(shift[1]),
        center_median_shifted_px=float(np.median(np.hypot(*(difference[:, :2] - shift).T))),
    )


def compare_with_labels(
    captures: CaptureSet, detected: Sequence[DetectedContact | None]
) -> LabelAgreement | None:
    """How far the detected circles lie from the given ones; None when none are given.

    ``detected`` has a contact a press, None where none was found. Circles that a person has
    corrected are not counted: nothing was detected there.
    """
    return agreement(
        [None if press.checked else press.circle for press in captures.presses],
        [None if contact is None else contact.circle for contact in detected],
    )


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
    def of(
        cls,
        presses: Sequence[CapturedPress],
        placed: Sequence[ContactCircle],
        found: Sequence[ContactCircle] | None = None,
    ) -> LabelPlacement:
        """From the training presses and where they were placed, those with labels.

        ``found`` are their circles by the images alone, where they were placed with the help of
        labels: errors that both sides of a regression share would make its slope too steep.
        """
        pairs = [
            (press.circle, *circles)
            for press, *circles in zip(presses, placed, found or placed, strict=True)
            if press.circle is not None
        ]
        if not pairs:
            return cls(np.zeros(3), 1.0, 0.0, np.zeros(3), 0)
        labels, at, found_at = (circle_array(circles) for circles in zip(*pairs, strict=True))
        count, middle = len(labels), labels.mean(axis=0)
        mean = at.mean(axis=0) - middle
        label_r, found_r = labels[:, 2] - middle[2], found_at[:, 2] - found_at[:, 2].mean()
        variance = label_r @ label_r
        prior = SLOPE_PRIOR * variance / count
        slope = float((label_r @ found_r + prior) / (variance + prior)) if variance > 0 else 1.0
        left = at - labels - mean
        left[:, 2] = at[:, 2] - at[:, 2].mean() - slope * label_r
        spread = left.std(axis=0, ddof=1) if count > 1 else np.zeros(3)
        return cls(mean, slope, float(middle[2]), spread, count)

    def sigma_px(self, placed_px: tuple[float, float]) -> tuple[float, float]:
        """Standard deviations of a placement by label, of the centre along an axis and of the
        radius [px], where those of the training presses' own places are ``placed_px``.

        What a label is off by is what it is off from such a place and what that is off by: a place
        that is the best estimate from label and image errs apart from its distance to the label.
        """
        off2 = self.deviation_px**2 * (1 + 1 / max(self.count, 1))
        center = np.hypot(np.sqrt(off2[:2].mean()), placed_px[0])
        return float(center), float(np.hypot(np.sqrt(off2[2]), placed_px[1]))

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
