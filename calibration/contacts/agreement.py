# SPDX-License-Identifier: Apache-2.0
"""Found against given contact circles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle


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
    difference = np.array(
        [
            (b.u_px - a.u_px, b.v_px - a.v_px, b.radius_px - a.radius_px)
            for a, b in zip(given, found, strict=True)
            if a is not None and b is not None
        ]
    )
    if not len(difference):
        return None
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


def compare_with_labels(captures: CaptureSet, detected: Sequence[Any]) -> LabelAgreement | None:
    """How far the detected circles lie from the given ones; None when none are given.

    ``detected`` holds a ``DetectedContact`` a press. Circles that a person has corrected are not
    counted: nothing was detected there.
    """
    return agreement(
        [None if press.checked else press.circle for press in captures.presses],
        [contact.circle for contact in detected],
    )
