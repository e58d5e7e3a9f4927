# SPDX-License-Identifier: Apache-2.0
"""What a person has to know of a depth calibration, and what its presses say against themselves:
labels off the dark patch, repeats, errors that a curve should not leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle, widest_gap_px
from taccel_lab.calibration.grey.result import DepthCalibration
from taccel_lab.calibration.remarks import warning
from taccel_lab.calibration.shared_remarks import (
    GREY_OR_COLOUR,
    HELDOUT_ERROR,
    LABELS_OFF,
    TOO_FEW,
)
from taccel_lab.report.remark import Remark

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


ZERO_UNSURE = warning(
    "zero_unsure",
    "depths are counted from {start}; all of them may be off alike by {zero:.2f} mm, and by what "
    "the rim itself has sunk. depth_mm of a press settles it",
)


def label_remarks(captures: CaptureSet, found: Sequence[ContactCircle]) -> list[Remark]:
    """Whether given circles lie on the dark patches of their images."""
    gaps = {
        press.name: seen.center_gap_px(press.circle, captures.grid)
        for press, seen in zip(captures.presses, found, strict=True)
        if press.circle is not None
    }
    radii = {press.name: press.circle.radius_px for press in captures.presses if press.circle}
    off = [n for n, gap in gaps.items() if gap > max(LABEL_OFF_PX, LABEL_OFF_SHARE * radii[n])]
    if not off:
        return []
    off.sort(key=lambda name: -gaps[name])
    worst = ", ".join(f"{name} by {gaps[name]:.0f} px" for name in off[:4])
    advice = "Calibrate with the circles found (--circles detected), or correct them"
    figures = {"off": len(off), "count": len(gaps), "how": worst, "advice": advice}
    return [LABELS_OFF(what="given circles", grave=True, **figures)]


def place_remarks(circles: Sequence[ContactCircle]) -> list[Remark]:
    """Whether all presses are at one place."""
    reach = widest_gap_px(circles)
    if len(circles) > 1 and reach < ONE_SPOT_RADII * float(
        np.median([c.radius_px for c in circles])
    ):
        wanted = f"all lie within {reach:.0f} px; press in the middle and near the borders"
        return [TOO_FEW(count=len(circles), what="presses at one spot", wanted=wanted)]
    return []


def error_remarks(left_out_mm: np.ndarray, depth_mm: np.ndarray, left_out: str) -> list[Remark]:
    """Whether left-out pixels lie far from the curve, for the depths that there are."""
    share = float(left_out_mm.mean() / max(float(depth_mm.mean()), 1e-9))
    if share <= POOR_CURVE:
        return []
    error = f"{left_out_mm.mean():.3f} mm, {share:.0%} of the mean depth"
    advice = "check circles, balls, and that all presses are of one sensor under one light"
    what = f"pixels of a {left_out}"
    return [HELDOUT_ERROR(what=what, error=error, advice=advice, grave=share > WRONG_CURVE)]


def curve_remarks(result: DepthCalibration, drops: Sequence[np.ndarray]) -> list[Remark]:
    """Remarks on the curve and the images; ``drops`` are the presses' grey drops [levels]."""
    found: list[Remark] = []
    if len(result.presses) < 3:
        wanted = "give three or more, one in the middle and others near the borders"
        found.append(TOO_FEW(count=len(result.presses), what="presses", wanted=wanted))
    sigma, zero = result.offset_sigma_mm, result.zero_sigma_mm
    depth = float(np.concatenate([part.depth_mm for part in result.parts]).mean())
    if zero > POOR_CURVE * depth and result.zero in ("untouched", "rim"):
        rim = f"the contact's rim, which is known to {sigma:.2f} mm"
        start = rim if result.zero == "rim" else "where the grey is that of untouched gel"
        found.append(ZERO_UNSURE(start=start, zero=zero))
    background = result.captures.background
    colors = [
        np.abs(np.ptp(background - p.image().astype(np.float64), axis=-1))[d > d.max() / 2]
        for p, d in zip(result.captures.presses, drops, strict=True)
    ]
    spread = float(np.mean([c.mean() for c in colors]))
    if spread > COLOR_LEVELS + 0.25 * max(float(d.max()) for d in drops):
        coloured = f"coloured (channels differ by {spread:.0f} levels in the contacts)"
        found.append(GREY_OR_COLOUR(found=coloured, expected="grey", grave=True))
    return found
