# SPDX-License-Identifier: Apache-2.0
"""What a person has to know about a colour calibration, beyond what its captures already show."""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.calibration.color.heldout import mean_bare
from taccel_lab.calibration.color.result import ColorCalibration
from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Remark, Severity

LEAST_PRESSES = 4
"""With fewer presses a model knows a few places and depths, and nothing tells of the others."""
LEAST_GAIN_DB = 6.0
"""A colour model that beats the bare background by less, in the crop, explains little."""
OUTLIER_FACTOR = 2.5
"""A press that is predicted worse than the median by this factor is named."""
OUTLIER_LEVELS = 3.0
"""And by these levels at least."""
SCALE_OFF = 0.04
"""Radii that are all off by more than this share are worth a remark."""
MOVED_RADII = 0.15
"""A circle whose centre moves by more than this share of its radius is named."""
LABELS_BESIDE = 0.05
"""Labels that all lie beside the contacts by more than this share of their radii are worth one."""
FAR_LEVELS = 6.0
"""Captures that differ from the background by more far from the contact have drifted."""
UNSURE_SHARE = 0.5
"""Fits whose disagreement is more than this share of their error lack presses."""

FEW_PRESSES = RemarkKind(
    "color_few_presses",
    Severity.ERROR,
    "the model was fitted to {presses}: it holds at those places and depths at best. Give 30 to "
    "50, spread over the gel",
)
ONLY_LEFT_OUT = RemarkKind(
    "only_left_out",
    Severity.INFO,
    "no press was held out; presses left out of single fits are the only figures",
)
NOTHING_HELD_OUT = RemarkKind(
    "nothing_held_out",
    Severity.WARNING,
    "no press was held out, so that nothing tells how well the model does on others; use "
    "--holdout-every 4",
)
EXPLAINS_LITTLE = RemarkKind(
    "explains_little",
    Severity.ERROR,
    "held-out presses are rendered at {model:.1f} dB, the bare background alone has {bare:.1f} dB: "
    "circles, scale, ball or background are wrong, or the gel was not pressed where it is held out",
)
HELDOUT_FAILED = RemarkKind(
    "color_heldout_failed",
    Severity.WARNING,
    "{failed} of {count} held-out presses could not be rendered and count as the bare background: "
    "{reasons}",
)
OUTLIERS = RemarkKind(
    "outliers",
    Severity.WARNING,
    "{worse} of {count} presses are predicted much worse than the median of {median:.1f} levels: "
    "{names}; look at their images and circles (taccel-lab capture review), and leave out what is "
    "not a clean ball press",
)
CIRCLES_OFF = RemarkKind(
    "color_circles_off",
    Severity.WARNING,
    "all contact circles look too {size}: {scale:.3f} times their radii predict left-out presses "
    "best. Labels that include the sunk rim do that; so do a wrong scale and a wrong ball radius, "
    "which the colours alone cannot tell apart",
)
CIRCLES_MOVED = RemarkKind(
    "circles_moved",
    Severity.WARNING,
    "the colours put {moved} of {count} contacts well away from their circles: {names}; correct "
    "these circles (taccel-lab capture review)",
)
LABELS_OFF = RemarkKind(
    "labels_beside",
    Severity.INFO,
    "labels lie off the contacts, all alike: found less labelled, {u:+.1f} and {v:+.1f} px for the "
    "centre and {radius:+.1f} px for the radius, mean over {count} presses. Figures by label have "
    "that put right; a press that you render at its bare label is off by as much. To keep to "
    "labels that you trust: --circles labels --no-register",
)
DRIFT_TAKEN_OFF = RemarkKind(
    "drift_taken_off",
    Severity.WARNING,
    "the light drifts between the frames; it was taken off each of them{gain}. Fix exposure and "
    "white balance of the camera: renders are in the light of the background image",
)
OFF_BACKGROUND = RemarkKind(
    "off_background",
    Severity.WARNING,
    "captures differ from the background by {levels:.1f} levels where nothing touches: take a new "
    "background with the same exposure and white balance, or calibrate with --drift on",
)
FITS_DISAGREE = RemarkKind(
    "fits_disagree",
    Severity.INFO,
    "fits to different presses disagree by {spread:.1f} levels in the contacts, of {error:.1f} "
    "that they are off: more presses would help",
)


def color_remarks(result: ColorCalibration) -> list[Remark]:
    """Remarks on a fit and its figures."""
    return [
        *_few(result),
        *_against_background(result),
        *_failures(result),
        *_outliers(result),
        *_circles(result),
        *_labels(result),
        *_light(result),
        *_spread(result),
    ]


def _few(result: ColorCalibration) -> list[Remark]:
    count = len(result.train_names)
    if count >= LEAST_PRESSES:
        return []
    return [FEW_PRESSES(presses=f"{count} press{'es' if count != 1 else ''}")]


def _against_background(result: ColorCalibration) -> list[Remark]:
    if not result.has_scores:
        return [ONLY_LEFT_OUT() if result.validated else NOTHING_HELD_OUT()]
    model = result.heldout_means()["crop_psnr_db"]
    bare = mean_bare(result.heldout, result.failures)["crop_psnr_db"]
    if model - bare >= LEAST_GAIN_DB:
        return []
    return [EXPLAINS_LITTLE(model=model, bare=bare)]


def _failures(result: ColorCalibration) -> list[Remark]:
    if not result.failures:
        return []
    named = "; ".join(f"{item.name}: {item.reason}" for item in result.failures)
    count = len(result.failures)
    return [HELDOUT_FAILED(failed=count, count=count + len(result.heldout), reasons=named)]


def _outliers(result: ColorCalibration) -> list[Remark]:
    values = {**result.left_out_l1, **result.heldout_l1()}
    if len(values) < 5:
        return []
    median = float(np.median(list(values.values())))
    limit = max(OUTLIER_FACTOR * median, median + OUTLIER_LEVELS)
    worst = sorted((name for name in values if values[name] > limit), key=lambda n: -values[n])
    if not worst:
        return []
    named = ", ".join(f"{name} ({values[name]:.1f})" for name in worst[:5])
    more = f" and {len(worst) - 5} more" if len(worst) > 5 else ""
    return [OUTLIERS(worse=len(worst), count=len(values), median=median, names=f"{named}{more}")]


def _circles(result: ColorCalibration) -> list[Remark]:
    found = result.registration
    if found is None:
        return []
    remarks = []
    if abs(found.scale - 1) > SCALE_OFF:
        size = "large" if found.scale < 1 else "small"
        remarks.append(CIRCLES_OFF(size=size, scale=found.scale))
    far = [
        name
        for name, a, b in zip(result.train_names, result.start_circles, result.circles, strict=True)
        if np.hypot(b.u_px - a.u_px, b.v_px - a.v_px) > MOVED_RADII * a.radius_px
    ]
    if far:
        named = ", ".join(far[:6]) + (f" and {len(far) - 6} more" if len(far) > 6 else "")
        remarks.append(CIRCLES_MOVED(moved=len(far), count=len(result.circles), names=named))
    return remarks


def _labels(result: ColorCalibration) -> list[Remark]:
    shift = result.label_shift
    if not shift.count:
        return []
    u, v, radius = (float(value) for value in shift.mean_px)
    if max(math.hypot(u, v), abs(radius)) <= LABELS_BESIDE * shift.mean_radius_px:
        return []
    return [LABELS_OFF(u=u, v=v, radius=radius, count=shift.count)]


def _light(result: ColorCalibration) -> list[Remark]:
    choice = result.drift_choice
    if result.drift_corrected:
        gain = ""
        if choice is not None:
            gain = (
                f" (untouched gel is then {choice.corrected_levels:.1f} levels from the background "
                f"instead of {choice.captured_levels:.1f})"
            )
        return [DRIFT_TAKEN_OFF(gain=gain)]
    if result.noise_floor_l1 > FAR_LEVELS:
        return [OFF_BACKGROUND(levels=result.noise_floor_l1)]
    return []


def _spread(result: ColorCalibration) -> list[Remark]:
    if result.spread is None or not result.validated:
        return []
    error = float(np.mean(list(result.left_out_l1.values())))
    if result.spread.disc_levels < UNSURE_SHARE * error:
        return []
    return [FITS_DISAGREE(spread=result.spread.disc_levels, error=error)]
