# SPDX-License-Identifier: Apache-2.0
"""What a user has to know of an inverse model that was fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.normals.samples import InverseFrame, Scene
from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Remark, Severity

ENOUGH_PRESSES, LEAST_PRESSES = 8, 4
"""Fitted presses below which a model is only usable, or weak: it knows a few places and slopes."""
GOOD_OVER_FLAT = 0.25
WEAK_OVER_FLAT = 0.5
"""Error over that of guessing a flat surface, above which a model is only usable, or weak."""
GREY_LEVELS = 1.5

FEW_PRESSES = RemarkKind(
    "normals_few_presses",
    Severity.WARNING,
    "only {presses} fitted; give 30 to 50, spread over the image",
    graver=Severity.ERROR,
)
NO_HELDOUT = RemarkKind(
    "no_heldout",
    Severity.WARNING,
    "no press was held out, so nothing says how well unseen presses are read",
)
LARGE_ERROR = RemarkKind(
    "normals_large_error",
    Severity.WARNING,
    "normals of held-out presses are off by {error:.1f} degrees, {share:.0%} of what a flat guess "
    "is off; check the circles, the ball's radius and the scale, or give more presses",
    graver=Severity.ERROR,
)
HELDOUT_FAILED = RemarkKind(
    "normals_heldout_failed",
    Severity.WARNING,
    "{count} held-out presses could not be read and count as a flat guess: {reasons}",
)
LIGHT_DRIFTS = RemarkKind(
    "normals_light_drifts",
    Severity.INFO,
    "untouched gel differs from the background by {before:.1f} levels, {after:.1f} once each "
    "frame's light is brought to it; the model needs that of new images too (the depth command "
    "does it). Fix exposure and white balance if you can",
)
GREY = RemarkKind(
    "grey",
    Severity.ERROR,
    "the colour channels change alike (to {levels:.1f} levels): a grey sensor tells no normals by "
    "colour; use taccel-lab calibrate depth",
)


def remarks_of(
    result: NormalCalibration, training: Sequence[InverseFrame], scene: Scene
) -> tuple[Remark, ...]:
    """Remarks on the data and on how well the held-out presses are read."""
    found: list[Remark] = []
    if len(training) < ENOUGH_PRESSES:
        count = len(training)
        presses = f"{count} press{'es were' if count != 1 else ' was'}"
        found.append(FEW_PRESSES(presses=presses, grave=count < LEAST_PRESSES))
    if not result.heldout:
        found.append(NO_HELDOUT())
    else:
        scores = result.heldout_means("used")
        share = scores["mean_deg"] / max(scores["flat_deg"], 1e-9)
        if share > GOOD_OVER_FLAT:
            grave = share > WEAK_OVER_FLAT
            found.append(LARGE_ERROR(error=scores["mean_deg"], share=share, grave=grave))
    if result.failures:
        reasons = "; ".join(f"{name}: {why}" for name, why in result.failures.items())
        found.append(HELDOUT_FAILED(count=len(result.failures), reasons=reasons))
    before, after = result.flat_noise_levels
    if result.fit.model.config.light_drift:
        found.append(LIGHT_DRIFTS(before=before, after=after))
    change = np.mean([_grey_share(frame, scene) for frame in training])
    if change < GREY_LEVELS:
        found.append(GREY(levels=change))
    return tuple(found)


def _grey_share(frame: InverseFrame, scene: Scene) -> float:
    """How far the channels' changes differ inside the contact [levels]."""
    inside = frame.circle.distance_px(scene.grid) <= frame.circle.radius_px
    change = (frame.image - scene.background)[inside]
    return float(np.abs(change - change.mean(axis=1, keepdims=True)).mean())
