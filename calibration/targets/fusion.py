# SPDX-License-Identifier: Apache-2.0
"""Two measurements of each contact circle, by hand and by detection, made into one better one.

Their errors are independent, so that the mean of the two is closer to the truth than either, and
the covariance of the two sets of radii is the true variance among the presses. The radii are drawn
towards their common mean by the share of the observed variance that is error (the James-Stein /
Kelley estimate of true scores, T. L. Kelley, Fundamentals of Statistics, 1947). It matters: near
the ball's equator one pixel of radius is 0.05 mm of depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from calibration.capture.captures import CaptureSet, ContactCircle
from calibration.targets.ball import DetectedContact
from taccel_lab.errors import InputError

MIN_PRESSES = 8
"""Below this many presses a covariance says nothing and the radii are only averaged."""


def fuse_circles(
    labels: Sequence[ContactCircle], detected: Sequence[ContactCircle]
) -> list[ContactCircle]:
    """One circle per press from a given and a detected one, in order."""
    if len(labels) != len(detected):
        raise InputError(f"{len(labels)} labels do not match {len(detected)} detected circles")
    given = np.array([[c.u_px, c.v_px, c.radius_px] for c in labels]).reshape(-1, 3)
    found = np.array([[c.u_px, c.v_px, c.radius_px] for c in detected]).reshape(-1, 3)
    fused = (given + found) / 2
    radius = fused[:, 2]
    if len(fused) >= MIN_PRESSES and radius.std() > 0:
        true_variance = np.cov(given[:, 2], found[:, 2])[0, 1]
        share = float(np.clip(true_variance / radius.var(ddof=1), 0.0, 1.0))
        fused[:, 2] = radius.mean() + share * (radius - radius.mean())
    return [ContactCircle(float(u), float(v), float(r)) for u, v, r in fused]


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
    if which == "fused":
        given = fuse_circles(given, [circles[i] for i in labelled])
    for i, circle in zip(labelled, given, strict=True):
        circles[i] = circle
    return circles
