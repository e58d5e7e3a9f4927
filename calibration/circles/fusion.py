# SPDX-License-Identifier: Apache-2.0
"""Two measurements of each contact circle, by hand and by detection, made into one better one.

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

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.circles.circle_arrays import circle_array, circle_of
from taccel_lab.calibration.circles.result import DetectedContact
from taccel_lab.errors import InputError

MIN_PRESSES = 8
"""Below this many presses their scatter and covariance say nothing."""
LABEL_SHIFT_PX = 3.0
"""Standard deviation of a shift that all labels of a set share, along an axis and in radius."""
LABEL_SIGMA_PX = 1.0
"""Scatter of labels where there are too few to tell."""
MIN_LABEL_SIGMA_PX = 0.29
"""No label is better than one on whole pixels."""
MIN_SIGMA_PX = 0.05


@dataclass(frozen=True)
class FusedCircles:
    """Fused circles with what they say of the labels."""

    circles: list[ContactCircle]
    """One a press, in order."""
    shift_px: np.ndarray
    """What all labels lie off by, along u and v and in radius [px], shape [3]."""
    shift_sigma_px: np.ndarray
    """Its standard deviation, shape [3]."""
    label_sigma_px: tuple[float, float]
    """Scatter of the labels beside that: along an axis, and in radius [px]."""


def fuse_circles(
    labels: Sequence[ContactCircle],
    detected: Sequence[DetectedContact],
    training: Sequence[bool] | None = None,
) -> FusedCircles:
    """One circle per press from a given and a detected one, in order.

    What the presses have in common (the labels' shift and scatter, mean and spread of the radii) is
    taken from the ``training`` presses; from all without.
    """
    if len(labels) != len(detected):
        raise InputError(f"{len(labels)} labels do not match {len(detected)} detected circles")
    train = np.ones(len(labels), dtype=bool) if training is None else np.asarray(training, bool)
    if not len(labels) or not train.any():
        raise InputError("circles are fused from at least one labelled training press")
    given = circle_array(labels)
    found = circle_array([contact.circle for contact in detected])
    stated = np.array([(c.center_sigma_px, c.center_sigma_px, c.radius_sigma_px) for c in detected])
    variance = np.maximum(stated, MIN_SIGMA_PX) ** 2
    scatter = _label_variance((given - found)[train], variance[train])
    weight = 1 / (variance + scatter)
    chance = 1 / weight[train].sum(axis=0)
    mean = chance * (weight * (given - found))[train].sum(axis=0)
    of_labels, of_found = LABEL_SHIFT_PX**2, variance[train].min(axis=0)
    whole = of_labels + of_found + chance
    shift, moved = mean * of_labels / whole, -mean * of_found / whole
    true_by_found, true_by_label = found - moved, given - shift
    fused = true_by_found + variance * weight * (true_by_label - true_by_found)
    radius = fused[:, 2]
    if train.sum() >= MIN_PRESSES and radius[train].std() > 0:
        true_variance = np.cov(given[train, 2], found[train, 2])[0, 1]
        share = float(np.clip(true_variance / radius[train].var(ddof=1), 0.0, 1.0))
        middle = radius[train].mean()
        fused[:, 2] = middle + share * (radius - middle)
    return FusedCircles(
        [circle_of(shape) for shape in fused],
        shift,
        np.sqrt(of_labels * (of_found + chance) / whole),
        (float(np.sqrt(scatter[0])), float(np.sqrt(scatter[2]))),
    )


def choose_circles(
    captures: CaptureSet,
    detected: Sequence[DetectedContact],
    which: Literal["fused", "labels", "detected"] = "fused",
    training: Collection[str] | None = None,
) -> list[ContactCircle]:
    """Contact circle of every press: given, detected, or fused from both.

    A press without a given circle takes the detected one; a circle that a person has corrected
    (``contacts.toml``) is taken as it is. ``training`` names the presses that may say what all
    labels have in common; all may without.
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
        known = [training is None or captures.presses[i].name in training for i in labelled]
        if not any(known):
            # Nothing tells where labels lie against detected circles.
            return circles
        given = fuse_circles(given, [detected[i] for i in labelled], known).circles
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
