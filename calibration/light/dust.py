# SPDX-License-Identifier: Apache-2.0
"""Specks that stay in place: dust and scratches on window, gel or lens."""

from __future__ import annotations

import cv2
import numpy as np

from taccel_lab.calibration.robust_spread import spread_about_median
from taccel_lab.calibration.smoothing import smoothed

SPECK_SHARE = 1 / 60
"""Size below which something is a speck rather than a shade, as a part of the shorter side."""
SIGMAS = 8.0
MIN_LEVELS = 6.0


def dust_mask(image: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """Specks of an image, bool, shape [height_px, width_px].

    ``image`` holds RGB levels, or differences of levels. A speck is smaller than a sixtieth of the
    shorter side and stands out of its surroundings by 8 robust standard deviations and 6 levels.
    """
    sigma = max(min(image.shape[:2]) * SPECK_SHARE, 1.5)
    fine = smoothed(image, mask, 0.6) - smoothed(image, mask, sigma)
    strength = np.linalg.norm(fine, axis=-1)
    usable = strength if mask is None else strength[mask]
    noise = spread_about_median(usable)
    specks = strength > max(MIN_LEVELS, float(np.median(usable)) + SIGMAS * noise)
    if mask is not None:
        # Next to masked pixels the surroundings are one-sided.
        inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=1) > 0
        specks &= inner
    _, parts, stats, _ = cv2.connectedComponentsWithStats(specks.astype(np.uint8))
    small = stats[:, cv2.CC_STAT_AREA] < (4 * sigma) ** 2
    small[0] = False
    specks = small[parts]
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
    return cv2.dilate(specks.astype(np.uint8), kernel) > 0


def speck_count(specks: np.ndarray) -> int:
    """Connected specks of a mask."""
    return int(cv2.connectedComponents(specks.astype(np.uint8))[0]) - 1
