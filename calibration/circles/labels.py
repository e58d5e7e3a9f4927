# SPDX-License-Identifier: Apache-2.0
"""Contacts that were found in images, and two measurements of each circle, by hand and by
detection, made into one better one.

Where presses lie against each other, labels and detection tell independently. Where all of them
lie, and where a contact is said to end, they do not: labels of one set may all lie to one side, or
all mean a wider circle (by 1 to 3 px on the sets in docs/calibration_contacts.md), and the
detection's model has an error in common as well. For each of u, v and radius

    label_i = true_i + s + e_i,    found_i = true_i + b + d_i,

with the labels' shift s ~ N(0, ``LABEL_SHIFT_PX``), the detection's b within the smallest of its
stated standard deviations (what all presses have in common is in each of them), its own d_i as
stated, and the scatter e_i of the labels from what is left of label - found. The mean of that
difference over the training presses is shared out between s, b and chance; each circle is then the
inverse-variance mean of label - s and found - b (best linear unbiased prediction, G. K. Robinson,
Statistical Science 6, 1991).

The radii are drawn towards their common mean by the share of the observed variance that is error
(the James-Stein / Kelley estimate of true scores, T. L. Kelley, Fundamentals of Statistics, 1947);
the covariance of the two sets of radii is the true variance among the presses. It matters: near the
ball's equator one pixel of radius is 0.05 mm of depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from taccel_lab.calibration.capture.captures import (
    EQUATOR_SLACK,
    CapturedPress,
    CaptureSet,
    ContactCircle,
)
from taccel_lab.errors import InputError

SLOPE_PRIOR = 2.0
"""Presses that the line of the radii counts a slope of one as."""
MIN_PRESSES = 8
"""Fewer presses say nothing by their scatter and covariance."""
LABEL_SHIFT_PX = 3.0
"""Standard deviation of a shift that all labels of a set share, along an axis and in radius."""
LABEL_SIGMA_PX = 1.0
"""Scatter of labels where there are too few to tell."""
MIN_LABEL_SIGMA_PX = 0.29
"""No label is better than one on whole pixels."""
MIN_SIGMA_PX = 0.05


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
    """Slope of placed over label radius, drawn to one by ``SLOPE_PRIOR`` presses."""
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
        """Fit to the training presses with labels, and where they were placed.

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


def fuse_circles(
    labels: Sequence[ContactCircle],
    detected: Sequence[DetectedContact],
) -> tuple[list[ContactCircle], tuple[float, float]]:
    """One circle per training press from a given and a detected one, in order; the labels' scatter
    beside their shift, along an axis and in radius [px]."""
    if len(labels) != len(detected):
        raise InputError(f"{len(labels)} labels do not match {len(detected)} detected circles")
    if not labels:
        raise InputError("circles are fused from at least one labelled training press")
    given = circle_array(labels)
    found = circle_array([contact.circle for contact in detected])
    stated = np.array([(c.center_sigma_px, c.center_sigma_px, c.radius_sigma_px) for c in detected])
    variance = np.maximum(stated, MIN_SIGMA_PX) ** 2
    scatter = _label_variance(given - found, variance)
    weight = 1 / (variance + scatter)
    chance = 1 / weight.sum(axis=0)
    mean = chance * (weight * (given - found)).sum(axis=0)
    of_labels, of_found = LABEL_SHIFT_PX**2, variance.min(axis=0)
    whole = of_labels + of_found + chance
    shift, moved = mean * of_labels / whole, -mean * of_found / whole
    true_by_found, true_by_label = found - moved, given - shift
    fused = true_by_found + variance * weight * (true_by_label - true_by_found)
    radius = fused[:, 2]
    if len(labels) >= MIN_PRESSES and radius.std() > 0:
        true_variance = np.cov(given[:, 2], found[:, 2])[0, 1]
        share = float(np.clip(true_variance / radius.var(ddof=1), 0.0, 1.0))
        middle = radius.mean()
        fused[:, 2] = middle + share * (radius - middle)
    label_sigma_px = float(np.sqrt(scatter[0])), float(np.sqrt(scatter[2]))
    return [circle_of(shape) for shape in fused], label_sigma_px


def choose_circles(
    captures: CaptureSet,
    detected: Sequence[DetectedContact],
    which: Literal["fused", "labels", "detected"] = "fused",
) -> list[ContactCircle]:
    """Contact circle of every press: given, detected, or fused from both.

    A press without a given circle takes the detected one; a circle that a person has corrected
    (``contacts.toml``) is taken as it is.
    """
    circles = [contact.circle for contact in detected]
    for i, press in enumerate(captures.presses):
        if press.checked and press.circle is not None:
            circles[i] = press.circle
    if which == "detected":
        return circles
    labelled = [i for i, press in enumerate(captures.presses) if press.circle and not press.checked]
    given = [press.circle for press in captures.presses if press.circle and not press.checked]
    if which == "fused" and labelled:
        given, _ = fuse_circles(given, [detected[i] for i in labelled])
    for i, circle in zip(labelled, given, strict=True):
        circles[i] = circle
    return circles


def _label_variance(difference: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Variance of labels beside their shift, along u and v alike and in radius [px^2], shape [3].

    The variance of label - found less what the detection states for its own part.
    """
    if len(difference) < MIN_PRESSES:
        return np.full(3, LABEL_SIGMA_PX**2)
    left = difference.var(axis=0, ddof=1) - variance.mean(axis=0)
    center, radius = np.maximum([left[:2].mean(), left[2]], MIN_LABEL_SIGMA_PX**2)
    return np.array([center, center, radius])
