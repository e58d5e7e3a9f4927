# SPDX-License-Identifier: Apache-2.0
"""Pixels that dots cover, and a picture as it would be without them.

Colours tell no slope under a dot. A dark dot stands out of the closing of its picture, a maximum
and a minimum over a window wider than the dot (Serra, Image Analysis and Mathematical Morphology,
1982). The lattice of the untouched picture says that there are dots, and how far apart.

What a touch changes around a dot goes on under it as a membrane that is held at the dot's rim:
exactly so where it changes evenly.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import KDTree

from taccel_lab.reading.dots.blobs import MIN_SIZE_PX, grey_levels
from taccel_lab.reading.dots.marker_picture import MIN_DOTS, MarkerPicture, markers_or_none
from taccel_lab.reading.thumb import resized

WINDOW_SHARE = 0.6
"""Window of the closing, as a part of the dots' pitch."""
MOST_UNEVEN = 1.4
"""Ratio of the upper to the lower quartile of the distances to the nearest spot: lattices of dots
have 1.03 to 1.14, dirt and shades 1.6 to 6."""
LEAST_WINDOW_PX = 9
"""Width of the window, where a picture made small for it is fine enough."""
DARKER = 0.15
"""Part of the light that a dot takes at least."""
MARGIN_SHARE = 0.06
"""Rim around a dot that is covered, too, as a part of the pitch: lenses blur it."""
COARSE_PARTS = 12
"""Dots are narrower than this part of the shorter side: what a first look for them takes."""
SWEEPS, COARSEST_PX = 4, 4
"""Sweeps over each picture of a half of the size: 0.5 levels from a membrane, of changes of 290;
and the size of the last one."""
NEIGHBOURS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.float32) / 4


@dataclass(frozen=True)
class DotMask:
    """Where dots are."""

    at_rest: np.ndarray
    """Pixels that dots cover in the untouched picture, bool, shape [height_px, width_px]."""
    pitch_px: float
    markers: MarkerPicture
    """The untouched picture's dots."""

    @classmethod
    def of(cls, untouched: np.ndarray) -> DotMask | None:
        """The dots of an untouched picture, RGB levels, shape [height_px, width_px, 3]; None where
        it shows no lattice of dark ones."""
        if min(untouched.shape[:2]) < MIN_SIZE_PX:
            return None
        coarse = min(untouched.shape[:2]) / COARSE_PARTS / WINDOW_SHARE
        if not _stand_evenly(_covered(untouched, coarse)):
            return None
        found = markers_or_none(np.clip(untouched, 0, 255).astype(np.uint8))
        if found is None:
            return None
        pitch = float(min(found.layout_px.pitch))
        return cls(_covered(untouched, pitch), pitch, found)

    def covered(self, image: np.ndarray) -> np.ndarray:
        """Pixels that a dot covers, here or at rest, bool, [height_px, width_px]."""
        return self.at_rest | _covered(image, self.pitch_px)


def painted_over(values: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Values with those that are not ``free`` [h, w] in place of what lies around, float32, shape
    [h, w, n]: each the mean of its four neighbours, found on pictures of half the size first."""
    if free.all() or min(free.shape) < COARSEST_PX:
        return values
    height, width = free.shape
    size = -(-width // 2), -(-height // 2)
    kept = free.astype(np.uint8)
    share = resized(free.astype(np.float32), size)
    means = resized(cv2.copyTo(values, kept), size) / np.maximum(share, 1e-6)[..., None]
    found = cv2.resize(painted_over(means, share > 0), (width, height))
    cv2.copyTo(values, kept, found)
    for _ in range(SWEEPS):
        found = cv2.filter2D(found, -1, NEIGHBOURS, borderType=cv2.BORDER_REPLICATE)
        cv2.copyTo(values, kept, found)
    return found


def _stand_evenly(dark: np.ndarray) -> bool:
    """Whether spots [height_px, width_px] of one size stand as far from each other as dots do:
    dirt and shades, among which to look for a lattice takes seconds, do not."""
    _, _, stats, middles = cv2.connectedComponentsWithStats(dark.astype(np.uint8))
    area = stats[1:, cv2.CC_STAT_AREA]
    if len(area) < MIN_DOTS:
        return False
    usual = np.median(area)
    spots = middles[1:][(area > usual / 2) & (area < 2 * usual)]
    if len(spots) < MIN_DOTS:
        return False
    apart = np.asarray(KDTree(spots).query(spots, 2)[0])[:, 1]
    near, far = np.quantile(apart, [0.25, 0.75])
    return bool(far <= MOST_UNEVEN * near)


def _covered(image: np.ndarray, pitch_px: float) -> np.ndarray:
    """Pixels that are darker than what lies around them, with a rim, bool, [height_px, width_px].

    The light around dots is smooth: it is found on a picture whose window is ``LEAST_WINDOW_PX``
    wide, and widened by a pixel there, so that no dot's rim is left out for it.
    """
    grey = np.clip(grey_levels(image), 0, 255)
    height, width = grey.shape
    times = max(1, round(WINDOW_SHARE * pitch_px / LEAST_WINDOW_PX))
    around = grey
    if times > 1:
        size = max(1, round(width / times)), max(1, round(height / times))
        around = cv2.dilate(resized(grey, size), np.ones((3, 3), np.uint8))
    window = _disc(round(0.5 * WINDOW_SHARE * pitch_px / times))
    around = cv2.morphologyEx(around, cv2.MORPH_CLOSE, window)
    if times > 1:
        around = cv2.resize(around, (width, height), interpolation=cv2.INTER_LINEAR)
    dark = (around - grey > DARKER * np.maximum(around, 1.0)).astype(np.uint8)
    return cv2.dilate(dark, _disc(max(1, round(MARGIN_SHARE * pitch_px)))) > 0


def _disc(radius_px: int) -> np.ndarray:
    """Pixels of a disc, uint8: the same however a picture is turned, as OpenCV's ellipses are
    not."""
    away = np.arange(-radius_px, radius_px + 1)
    return (np.hypot(away[:, None], away) <= radius_px + 0.3).astype(np.uint8)
