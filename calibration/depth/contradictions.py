# SPDX-License-Identifier: Apache-2.0
"""What presses on a grey sensor say against themselves: labels off the dark patch, repeats, errors
that a curve should not leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.result import Remark, Severity
from taccel_lab.geometry import PixelGrid

LABEL_OFF_SHARE, LABEL_OFF_PX = 0.18, 6.0
"""A label is off when its centre lies this part of its radius, and this far, from the dark patch:
the limits of the check of coloured captures."""
ONE_SPOT_RADII = 1.0
"""Presses are at one spot when no two centres are this many contact radii apart."""
LARGE_ERROR, WRONG_CURVE = 0.15, 0.35
"""Left-out error over the mean depth, from which a curve is only usable, or weak. Presses of one
9DTact lie at 0.02 to 0.05, those of two different units under one curve at 0.1."""


def label_remarks(
    captures: CaptureSet,
    labels: Sequence[ContactCircle | None],
    found: Sequence[ContactCircle],
) -> list[Remark]:
    """Whether given circles lie on the dark patches of their images."""
    gaps = {
        press.name: _gap_px(label, seen, captures.grid)
        for press, label, seen in zip(captures.presses, labels, found, strict=True)
        if label is not None
    }
    radii = {p.name: c.radius_px for p, c in zip(captures.presses, labels, strict=True) if c}
    off = [n for n, gap in gaps.items() if gap > max(LABEL_OFF_PX, LABEL_OFF_SHARE * radii[n])]
    if not off:
        return []
    off.sort(key=lambda name: -gaps[name])
    return [
        Remark(
            Severity.ERROR,
            "labels_off",
            f"{len(off)} of {len(gaps)} given circles lie away from the dark patch of their image: "
            + ", ".join(f"{name} by {gaps[name]:.0f} px" for name in off[:4])
            + ". Calibrate with the circles found (--circles detected), or correct them",
        )
    ]


def repeat_remarks(captures: CaptureSet, circles: Sequence[ContactCircle]) -> list[Remark]:
    """Whether several presses are one and the same, or all at one place."""
    first: dict[str, str] = {}
    twins = []
    for press in captures.presses:
        if press.sha256 in first:
            twins.append(f"{press.name} is {first[press.sha256]}")
        first.setdefault(press.sha256, press.name)
    if twins:
        return [
            Remark(
                Severity.WARNING,
                "duplicates",
                f"{len(twins)} images are stored twice ({', '.join(twins[:4])}): they are one "
                "press, and leaving one out tells nothing. Remove them",
            )
        ]
    at = np.array([[c.u_px, c.v_px] for c in circles])
    reach = float(np.linalg.norm(at[:, None] - at[None], axis=-1).max())
    if len(circles) > 1 and reach < ONE_SPOT_RADII * float(
        np.median([c.radius_px for c in circles])
    ):
        return [
            Remark(
                Severity.WARNING,
                "one_spot",
                f"all {len(circles)} presses lie within {reach:.0f} px: nothing says how the curve "
                "holds elsewhere on the gel. Press in the middle and near the borders",
            )
        ]
    return []


def error_remarks(left_out_mm: np.ndarray, depth_mm: np.ndarray, left_out: str) -> list[Remark]:
    """Whether left-out pixels lie far from the curve, for the depths that there are."""
    share = float(left_out_mm.mean() / max(float(depth_mm.mean()), 1e-9))
    if share <= LARGE_ERROR:
        return []
    return [
        Remark(
            Severity.ERROR if share > WRONG_CURVE else Severity.WARNING,
            "large_error",
            f"pixels of a left-out {left_out} are off by {left_out_mm.mean():.3f} mm, {share:.0%} "
            "of the mean depth: grey does not tell depth well here. Check the circles and the "
            "balls' radii, and that all presses are of one sensor under one light",
        )
    ]


def _gap_px(label: ContactCircle, seen: ContactCircle, grid: PixelGrid) -> float:
    rows = grid.mm_per_px_y / grid.mm_per_px_x
    return float(np.hypot(seen.u_px - label.u_px, (seen.v_px - label.v_px) * rows))
