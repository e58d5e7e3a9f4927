# SPDX-License-Identifier: Apache-2.0
"""What a user has to know of an inverse model that was fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.normals.samples import InverseFrame, Scene
from taccel_lab.calibration.result import Remark, Severity

FEW_PRESSES, LEAST_PRESSES = 8, 4
"""Fitted presses below which a model is only usable, or weak: it knows a few places and slopes."""
GOOD_OVER_FLAT = 0.25
WEAK_OVER_FLAT = 0.5
"""Error over that of guessing a flat surface, above which a model is only usable, or weak."""
SHIFT_PX = 3.0
SHIFT_RADII = 0.08
"""A circle counts as off by more than both of these."""
SURE_RATIO = 1.5
"""Observed over expected error, either way, that is remarked on."""
SEEN_SHARE = 0.35
"""Share of the image, per axis, that contacts should span."""
GREY_LEVELS = 1.5


def remarks_of(
    result: NormalCalibration, training: Sequence[InverseFrame], scene: Scene
) -> tuple[Remark, ...]:
    """Remarks on the data and on how well the held-out presses are read."""
    found: list[Remark] = []

    def remark(severity: Severity, code: str, message: str) -> None:
        found.append(Remark(severity, code, message))

    if len(training) < FEW_PRESSES:
        count = len(training)
        remark(
            Severity.ERROR if count < LEAST_PRESSES else Severity.WARNING,
            "few_presses",
            f"only {count} press{'es were' if count != 1 else ' was'} fitted; give 30 to 50, "
            "spread over the image",
        )
    if not result.heldout:
        remark(
            Severity.WARNING,
            "no_heldout",
            "no press was held out, so nothing says how well unseen presses are read",
        )
    else:
        scores = result.heldout_means("used")
        share = scores["mean_deg"] / max(scores["flat_deg"], 1e-9)
        if share > GOOD_OVER_FLAT:
            remark(
                Severity.ERROR if share > WEAK_OVER_FLAT else Severity.WARNING,
                "large_error",
                f"normals of held-out presses are off by {scores['mean_deg']:.1f} degrees, "
                f"{share:.0%} of what a flat guess is off; check the circles, the ball's radius "
                "and the scale, or give more presses",
            )
    if result.failures:
        reasons = "; ".join(f"{name}: {why}" for name, why in result.failures.items())
        remark(
            Severity.WARNING,
            "heldout_failed",
            f"{len(result.failures)} held-out presses could not be read and count as a flat guess: "
            f"{reasons}",
        )
    ratio = None if result.reliability is None else result.reliability.ratio()
    if ratio is not None and not 1 / SURE_RATIO < ratio < SURE_RATIO:
        remark(
            Severity.WARNING,
            "uncertainty_off",
            f"held-out errors are {ratio:.2f} times what the model expects of itself",
        )
    off = {
        name: shift
        for name, shift in result.fit.label_shifts.items()
        if shift.length_px > max(SHIFT_PX, SHIFT_RADII * _radius_of(training, name))
    }
    if off:
        worst = sorted(off, key=lambda name: -off[name].length_px)[:4]
        remark(
            Severity.WARNING if len(off) > len(training) / 4 else Severity.INFO,
            "circles_off",
            f"{len(off)} of {len(training)} circles lie away from where the colours put the ball: "
            + ", ".join(f"{name} by {off[name].length_px:.1f} px" for name in worst),
        )
    for axis, size, at in (
        ("u", scene.grid.width_px, [frame.circle.u_px for frame in training]),
        ("v", scene.grid.height_px, [frame.circle.v_px for frame in training]),
    ):
        if np.ptp(at) < SEEN_SHARE * size:
            remark(
                Severity.WARNING,
                "one_spot",
                f"contacts span {np.ptp(at):.0f} of {size} px along {axis}; elsewhere the model "
                "extrapolates. Press near the borders too",
            )
    before, after = result.flat_noise_levels
    if result.fit.model.config.light_drift:
        remark(
            Severity.INFO,
            "light_drifts",
            f"untouched gel differs from the background by {before:.1f} levels, {after:.1f} once "
            "each frame's light is brought to it; the model needs that of new images too (the "
            "depth command does it). Fix exposure and white balance if you can",
        )
    change = np.mean([_grey_share(frame, scene) for frame in training])
    if change < GREY_LEVELS:
        remark(
            Severity.ERROR,
            "grey",
            f"the colour channels change alike (to {change:.1f} levels): a grey sensor tells no "
            "normals by colour; use taccel-lab calibrate depth",
        )
    return tuple(found)


def _radius_of(frames: Sequence[InverseFrame], name: str) -> float:
    return next(frame.circle.radius_px for frame in frames if frame.name == name)


def _grey_share(frame: InverseFrame, scene: Scene) -> float:
    """How far the channels' changes differ inside the contact [levels]."""
    inside = frame.circle.distance_px(scene.grid) <= frame.circle.radius_px
    change = (frame.image - scene.background)[inside]
    return float(np.abs(change - change.mean(axis=1, keepdims=True)).mean())
