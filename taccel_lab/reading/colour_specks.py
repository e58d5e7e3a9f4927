# SPDX-License-Identifier: Apache-2.0
"""Specks of dirt on a colour sensor: small spots of one change, with no other beside them.

A dent turns towards one lamp what it turns away from the other, and its far side does the opposite:
changes over all of it sum to next to nothing. A speck hides the gel, and its change is the same all
over.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from taccel_lab.reading.blocks import LARGEST_PX
from taccel_lab.reading.grey import NAMED_PX, SPECK_SHARE

AROUND_PX = 3 * LARGEST_PX
"""Pixels on each side of a speck that a coarse look takes for touched, too."""
LOUD_LEVELS = 8.0
"""Change of levels, in the channel that changes most, that spots are made out by."""
BESIDE_SHARE = 0.125
"""Distance, in thicknesses of the gel, within which two spots are parts of one: a small dent's
sides."""
ONE_CHANGE = 0.8
"""Square of the mean change of a spot over its mean square: rings of a ball have 0.1 to 0.4."""


WIDEST_MM = 1.0
"""Radius of the largest: what is wider is no dust."""


def colour_specks(
    levels: np.ndarray,
    untouched: np.ndarray,
    factor: np.ndarray | None,
    around: np.ndarray,
    pixel_mm: float,
    thickness_mm: float,
) -> np.ndarray | None:
    """Pixels of specks, bool, [h, w]; None where there are none.

    Args:
        levels: RGB, in the light of ``untouched`` and over ``factor``, shape [h, w, 3].
        untouched: The sensor without touch, likewise.
        factor: Common gain that was taken off, [h, w, n]; None of none.
        around: Blocks of ``LARGEST_PX`` pixels where something may touch, bool.
        pixel_mm: Width of a pixel [mm].
        thickness_mm: Of the gel.
    """
    beside_px = 2 * math.ceil(BESIDE_SHARE * thickness_mm / pixel_mm) + 1
    widest_px = 2 * min(SPECK_SHARE * thickness_mm, WIDEST_MM) / pixel_mm + beside_px
    found = None
    boxes = cv2.connectedComponentsWithStats(around.astype(np.uint8))[2][1:]
    for left, top, width, height, _ in LARGEST_PX * boxes:
        if max(width, height) > widest_px + 2 * AROUND_PX:
            continue
        window = np.s_[top : top + height, left : left + width]
        shown = levels[window] if factor is None else levels[window] * factor[window]
        specks = _specks(shown - untouched[window], beside_px, widest_px)
        if specks.any():
            found = np.zeros(levels.shape[:2], bool) if found is None else found
            found[window] |= specks
    return found


def _specks(change: np.ndarray, beside_px: int, widest_px: float) -> np.ndarray:
    """Pixels of specks, bool, [h, w], by a change of levels, [h, w, 3]."""
    found = np.zeros(change.shape[:2], bool)
    loud = np.abs(change).max(axis=-1) > LOUD_LEVELS
    near = cv2.dilate(loud.astype(np.uint8), np.ones((beside_px, beside_px), np.uint8))
    for left, top, width, height, _ in cv2.connectedComponentsWithStats(near)[2][1:]:
        reached = left == 0 or top == 0
        reached |= left + width == loud.shape[1] or top + height == loud.shape[0]
        if reached or max(width, height) > widest_px:
            continue
        window = np.s_[top : top + height, left : left + width]
        inside = loud[window]
        seen = change[window][inside]
        common, whole = np.square(seen.mean(axis=0)).sum(), np.square(seen).sum(axis=1).mean()
        if len(seen) >= NAMED_PX and common >= ONE_CHANGE * whole:
            found[window] |= inside
    return found
