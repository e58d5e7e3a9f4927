# SPDX-License-Identifier: Apache-2.0
"""What a user has to know of an inverse model that was fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.normals.samples import InverseFrame, Scene
from taccel_lab.calibration.normals.told_thickness import THICKEST_MM, ToldThickness
from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Remark, Severity

ENOUGH_PRESSES, LEAST_PRESSES = 8, 4
"""Fitted presses below which a model is only usable, or weak: it knows a few places and slopes."""
GOOD_OVER_FLAT = 0.25
WEAK_OVER_FLAT = 0.5
"""Error over that of guessing a flat surface, above which a model is only usable, or weak."""
SURE_RATIO = 1.5
"""Observed over expected error, either way, that is remarked on."""
LAYER_ERROR = 0.06
"""Share of the depth by which a bonded layer and finite elements differ at one contact radius: -4 %
without friction and deep, +7 % with friction 1."""
LAYER_FACTOR = 1.25
"""By what a layer of small strains without friction may misjudge the thickness of a gel: GelSight
Minis of 4 mm are read as 3.2 to 3.6 mm, with Poisson's ratio 0.46."""
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
UNCERTAINTY_OFF = RemarkKind(
    "uncertainty_off",
    Severity.WARNING,
    "held-out errors are {ratio:.2f} times what the model expects of itself",
)
DEPTH_DISAGREES = RemarkKind(
    "normals_depth_disagrees",
    Severity.WARNING,
    "held-out presses read {off:.3f} mm (+- {error:.3f}) {direction} than a ball that touches in "
    "their circles goes into the stated pad ({wanted:.2f} mm): its thickness, the ball's radius or "
    "the scale is not as stated. Measure the gel's thickness, or press once to a known depth",
)
GEL_DIFFERS = RemarkKind(
    "normals_gel_thickness",
    Severity.WARNING,
    "around the contacts the gel sinks as one of {told} would, {stated:g} mm are stated: in such a "
    "gel these presses are {depths} as deep. Measure its thickness and state it as thickness_mm "
    "under [design] in captures.toml, or press once to a known depth",
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
    found += _depth_disagrees(result) + _gel_differs(result.gel)
    ratio = None if result.reliability is None else result.reliability.ratio()
    if ratio is not None and not 1 / SURE_RATIO < ratio < SURE_RATIO:
        found.append(UNCERTAINTY_OFF(ratio=ratio))
    before, after = result.flat_noise_levels
    if result.fit.model.config.light_drift:
        found.append(LIGHT_DRIFTS(before=before, after=after))
    change = np.mean([_grey_share(frame, scene) for frame in training])
    if change < GREY_LEVELS:
        found.append(GREY(levels=change))
    return tuple(found)


def _depth_disagrees(result: NormalCalibration) -> list[Remark]:
    """Where image and pad do not tell one depth: by more than the presses scatter, and by more than
    a layer of small strains is off from finite elements."""
    depths = [item.depth for item in result.heldout if item.depth is not None]
    if len(depths) < LEAST_PRESSES:
        return []
    off = np.array([depth.deepest_mm for depth in depths])
    mean, error = float(off.mean()), float(off.std(ddof=1) / np.sqrt(len(off)))
    wanted = float(np.mean([depth.wanted_mm for depth in depths]))
    if abs(mean) < max(2 * error, LAYER_ERROR * wanted):
        return []
    direction = "deeper" if mean > 0 else "shallower"
    return [DEPTH_DISAGREES(off=abs(mean), error=error, direction=direction, wanted=wanted)]


def _gel_differs(gel: ToldThickness | None) -> list[Remark]:
    if gel is None or gel.low_mm / LAYER_FACTOR <= gel.stated_mm <= gel.high_mm * LAYER_FACTOR:
        return []
    if gel.high_mm < 0.99 * THICKEST_MM:
        told = f"{gel.low_mm:.1f} to {gel.high_mm:.1f} mm"
        depths = f"{gel.depth_low:.2f} to {gel.depth_high:.2f} times"
    else:
        told = f"{gel.low_mm:.1f} mm or more"
        depths = f"{gel.depth_low:.2f} times or more"
    return [GEL_DIFFERS(told=told, stated=gel.stated_mm, depths=depths)]


def _grey_share(frame: InverseFrame, scene: Scene) -> float:
    """How far the channels' changes differ inside the contact [levels]."""
    inside = frame.circle.distance_px(scene.grid) <= frame.circle.radius_px
    change = (frame.image - scene.background)[inside]
    return float(np.abs(change - change.mean(axis=1, keepdims=True)).mean())
