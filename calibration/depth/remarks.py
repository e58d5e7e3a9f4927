# SPDX-License-Identifier: Apache-2.0
"""What a person has to know of a depth calibration, and what its presses say against themselves:
labels off the dark patch, repeats, errors that a curve should not leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle, widest_gap_px
from taccel_lab.calibration.depth.result import DepthCalibration
from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Remark, Severity

LABEL_OFF_SHARE, LABEL_OFF_PX = 0.18, 6.0
"""A label is off when its centre lies this part of its radius, and this far, from the dark patch:
the limits of the check of coloured captures."""
ONE_SPOT_RADII = 1.0
"""Presses are at one spot when no two centres are this many contact radii apart."""
POOR_CURVE, WRONG_CURVE = 0.15, 0.35
"""Left-out error over the mean depth, from which a curve is only usable, or weak. Presses of one
9DTact lie at 0.02 to 0.05, those of two different units under one curve at 0.1."""

COLOR_LEVELS = 8.0
"""Channels that differ by more inside the contacts, beside a quarter of the drop: colours."""
SATURATED_LEVEL = 3.0
"""Pixels that brighten by more than this count as brightened."""
CLEAR_R2 = 0.25
"""Share of the residuals' variance by which uneven light is told."""

SCALE_OF_PROFILE = RemarkKind(
    "scale_of_profile",
    Severity.INFO,
    "the captures state no scale; {mm_per_px:.4g} mm/px is that of the profile ({kind}). Calibrate "
    "the camera on a board (taccel-lab calibrate camera)",
    graver=Severity.WARNING,
)
LABELS_OFF = RemarkKind(
    "depth_labels_off",
    Severity.ERROR,
    "{off} of {count} given circles lie away from the dark patch of their image: {gaps}. Calibrate "
    "with the circles found (--circles detected), or correct them",
)
ONE_SPOT = RemarkKind(
    "depth_one_spot",
    Severity.WARNING,
    "all {count} presses lie within {reach:.0f} px: nothing says how the curve holds elsewhere on "
    "the gel. Press in the middle and near the borders",
)
LARGE_ERROR = RemarkKind(
    "depth_large_error",
    Severity.WARNING,
    "pixels of a left-out {left_out} are off by {error:.3f} mm, {share:.0%} of the mean depth: "
    "grey does not tell depth well here. Check the circles and the balls' radii, and that all "
    "presses are of one sensor under one light",
    graver=Severity.ERROR,
)
FEW_PRESSES = RemarkKind(
    "depth_few_presses",
    Severity.WARNING,
    "{count} press; nothing says how the curve holds elsewhere on the gel. Give three or more, one "
    "in the middle and others near the borders",
)
ZERO_AT_NO_DROP = RemarkKind(
    "zero_at_no_drop",
    Severity.INFO,
    "depths are counted from where the grey is that of untouched gel, {below:.2f} mm {side} the "
    "rim that is seen, which is known to {sigma:.2f} mm. So all of them may be off alike by "
    "{zero:.2f} mm, and by what the rim itself has sunk. depth_mm of a press settles it",
    graver=Severity.WARNING,
)
ZERO_AT_RIM = RemarkKind(
    "zero_at_rim",
    Severity.INFO,
    "depths are counted from the contact's rim, which is known to {sigma:.2f} mm; by the grey of "
    "untouched gel they may be off alike by {zero:.2f} mm, and by what the rim itself has sunk. "
    "depth_mm of a press settles it",
    graver=Severity.WARNING,
)
TILTED_RESIDUAL = RemarkKind(
    "tilted_residual",
    Severity.WARNING,
    "{name}: depths by grey tilt against the ball by {tilt:.2f} mm across the contact: its centre "
    "is off, or the light is uneven",
)
BRIGHTENS = RemarkKind(
    "brightens",
    Severity.INFO,
    "{share:.0%} of the pixels brighten, by up to {levels:.0f} levels, beside the contacts: the "
    "slope of the gel throws light back. Such pixels read as untouched, and the rim of a contact "
    "reads too shallow",
)
UNEVEN_LIGHT = RemarkKind(
    "uneven_light",
    Severity.WARNING,
    "the light explains {share:.0%} of what the curve leaves over; dividing by the background "
    "would leave {divided:.3f} mm instead of {error:.3f} mm",
)
COLOURED = RemarkKind(
    "coloured",
    Severity.ERROR,
    "the channels differ by {levels:.0f} levels inside the contacts: this looks like a colour "
    "sensor, whose colours tell slopes; use taccel-lab calibrate normals",
)


def label_remarks(
    captures: CaptureSet,
    labels: Sequence[ContactCircle | None],
    found: Sequence[ContactCircle],
) -> list[Remark]:
    """Whether given circles lie on the dark patches of their images."""
    gaps = {
        press.name: seen.center_gap_px(label, captures.grid)
        for press, label, seen in zip(captures.presses, labels, found, strict=True)
        if label is not None
    }
    radii = {p.name: c.radius_px for p, c in zip(captures.presses, labels, strict=True) if c}
    off = [n for n, gap in gaps.items() if gap > max(LABEL_OFF_PX, LABEL_OFF_SHARE * radii[n])]
    if not off:
        return []
    off.sort(key=lambda name: -gaps[name])
    worst = ", ".join(f"{name} by {gaps[name]:.0f} px" for name in off[:4])
    return [LABELS_OFF(off=len(off), count=len(gaps), gaps=worst)]


def place_remarks(circles: Sequence[ContactCircle]) -> list[Remark]:
    """Whether all presses are at one place."""
    reach = widest_gap_px(circles)
    if len(circles) > 1 and reach < ONE_SPOT_RADII * float(
        np.median([c.radius_px for c in circles])
    ):
        return [ONE_SPOT(count=len(circles), reach=reach)]
    return []


def error_remarks(left_out_mm: np.ndarray, depth_mm: np.ndarray, left_out: str) -> list[Remark]:
    """Whether left-out pixels lie far from the curve, for the depths that there are."""
    share = float(left_out_mm.mean() / max(float(depth_mm.mean()), 1e-9))
    if share <= POOR_CURVE:
        return []
    return [
        LARGE_ERROR(
            left_out=left_out, error=left_out_mm.mean(), share=share, grave=share > WRONG_CURVE
        )
    ]


def curve_remarks(result: DepthCalibration, drops: Sequence[np.ndarray]) -> list[Remark]:
    """Remarks on the curve and the images; ``drops`` are the presses' grey drops [levels]."""
    found: list[Remark] = []
    if len(result.presses) < 3:
        found.append(FEW_PRESSES(count=len(result.presses)))
    sigma, zero = result.offset_sigma_mm, result.zero_sigma_mm
    depth = float(np.concatenate([part.depth_mm for part in result.parts]).mean())
    grave = zero > POOR_CURVE * depth
    if result.zero == "untouched":
        below = -float(np.mean([press.rim_depth_mm for press in result.presses]))
        found.append(
            ZERO_AT_NO_DROP(
                below=abs(below),
                side="below" if below >= 0 else "above",
                sigma=sigma,
                zero=zero,
                grave=grave,
            )
        )
    if result.zero == "rim":
        found.append(ZERO_AT_RIM(sigma=sigma, zero=zero, grave=grave))
    worst = max(result.presses, key=lambda p: p.plane_mm)
    if worst.plane_mm > max(0.15 * worst.depth_mm, 0.05):
        found.append(TILTED_RESIDUAL(name=worst.name, tilt=worst.plane_mm))
    share = np.mean([np.mean(d < -SATURATED_LEVEL) for d in drops])
    if share > 0.05:
        deepest = -min(float(np.percentile(d, 0.5)) for d in drops)
        found.append(BRIGHTENS(share=share, levels=deepest))
    if result.light_r2 > CLEAR_R2 and result.normalised_mae_mm < 0.9 * result.left_out_mm.mean():
        found.append(
            UNEVEN_LIGHT(
                share=result.light_r2,
                divided=result.normalised_mae_mm,
                error=result.left_out_mm.mean(),
            )
        )
    background = result.captures.background
    colors = [
        np.abs(np.ptp(background - p.image().astype(np.float64), axis=-1))[d > d.max() / 2]
        for p, d in zip(result.captures.presses, drops, strict=True)
    ]
    spread = float(np.mean([c.mean() for c in colors]))
    if spread > COLOR_LEVELS + 0.25 * max(float(d.max()) for d in drops):
        found.append(COLOURED(levels=spread))
    return found
