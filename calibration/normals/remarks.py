# SPDX-License-Identifier: Apache-2.0
"""What a user has to know of an inverse model that was fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.response.frame import CaptureScene, PressFrame
from taccel_lab.calibration.shared_remarks import (
    GREY_OR_COLOUR,
    HELDOUT_ERROR,
    NOTHING_HELD_OUT,
    TOO_FEW,
    left_out_remarks,
)
from taccel_lab.report.remark import Remark

ENOUGH_PRESSES, LEAST_PRESSES = 8, 4
"""Fitted presses below which a model is only usable, or weak: it knows a few places and slopes."""
GOOD_OVER_FLAT = 0.25
WEAK_OVER_FLAT = 0.5
"""Error over that of guessing a flat surface, above which a model is only usable, or weak."""
GREY_LEVELS = 1.5


def remarks_of(
    result: NormalCalibration, training: Sequence[PressFrame], scene: CaptureScene
) -> tuple[Remark, ...]:
    """Remarks on the data and on how well the held-out presses are read."""
    found: list[Remark] = []
    if len(training) < ENOUGH_PRESSES:
        count = len(training)
        wanted = "give 30 to 50, spread over the image"
        grave = count < LEAST_PRESSES
        found.append(TOO_FEW(count=count, what="presses fitted", wanted=wanted, grave=grave))
    if not result.has_scores:
        found.append(NOTHING_HELD_OUT())
    else:
        scores = result.heldout_means("used")
        share = scores["mean_deg"] / max(scores["flat_deg"], 1e-9)
        if share > GOOD_OVER_FLAT:
            grave = share > WEAK_OVER_FLAT
            error = f"{scores['mean_deg']:.1f} degrees, {share:.0%} of what a flat guess is off"
            advice = "check the circles, the ball's radius and the scale, or give more presses"
            found.append(HELDOUT_ERROR(what="normals", error=error, advice=advice, grave=grave))
    found += left_out_remarks(result.failed, result.rejected_deg(), "degrees")
    change = np.mean([_grey_share(frame, scene) for frame in training])
    if change < GREY_LEVELS:
        alike = f"grey (channels change alike, to {change:.1f} levels)"
        found.append(GREY_OR_COLOUR(found=alike, expected="coloured", grave=True))
    return tuple(found)


def _grey_share(frame: PressFrame, scene: CaptureScene) -> float:
    """How far the channels' changes differ inside the contact [levels]."""
    inside = frame.circle.distance_px(scene.grid) <= frame.circle.radius_px
    change = (frame.image - scene.background)[inside]
    return float(np.abs(change - change.mean(axis=1, keepdims=True)).mean())
