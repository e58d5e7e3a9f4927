# SPDX-License-Identifier: Apache-2.0
"""Whether images show the same gel through the same optics: misfit, channel order, crop.

All comparisons are of small images in one light, which takes out exposure and white balance, and by
medians, which a contact on a part of the gel does not move.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import cv2
import numpy as np

from taccel_lab.calibration.light.fit import fit_light

THUMB_PX = 160
"""Longer side of the small images."""
FITTED_PIXELS = 5000
"""Pixels that a fit of the light takes, evenly picked."""
MIN_CROP, CROP_STEP = 0.5, 0.01
OTHER_FRAMING_LEVELS = 5.0
"""Misfit from which two images are not of the same gel in the same framing."""
CROP_GAIN = 2.0
"""A crop is believed when it fits this many times better than the whole image."""
ORDERS: tuple[tuple[int, int, int], ...] = tuple(itertools.permutations(range(3)))  # type: ignore[assignment]


def thumb(image: np.ndarray, longer_px: int = THUMB_PX) -> np.ndarray:
    """The image made small by area averaging, float32, shape [h, w, 3]."""
    scale = min(1.0, longer_px / max(image.shape[:2]))
    size = (max(8, round(image.shape[1] * scale)), max(8, round(image.shape[0] * scale)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)


def in_light_of(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """``reference`` in the light of ``image``, levels, shape [h, w, 3]: gain and offset only."""
    step = max(1, round((reference.shape[0] * reference.shape[1] / FITTED_PIXELS) ** 0.5))
    light = fit_light(image[::step, ::step], reference[::step, ::step], gradient=False)
    return light.apply(reference)


def misfit_levels(image: np.ndarray, reference: np.ndarray) -> float:
    """Median distance of the colours after the fit [levels]: 1 to 3 for the same gel."""
    return float(np.median(np.linalg.norm(image - in_light_of(image, reference), axis=-1)))


def best_channel_order(
    image: np.ndarray, reference: np.ndarray
) -> tuple[tuple[int, int, int], float, float]:
    """Order of the channels of ``image`` that is nearest to ``reference``, by raw levels.

    Returns the order, its distance and that of the order as it is: medians over the pixels
    [levels], after a common shift of brightness.
    """
    distances = {}
    for order in ORDERS:
        change = image[..., list(order)] - reference
        change = change - np.median(change)
        distances[order] = float(np.median(np.linalg.norm(change, axis=-1)))
    best = min(distances, key=lambda order: distances[order])
    return best, distances[best], distances[0, 1, 2]


@dataclass(frozen=True)
class Crop:
    """Part of an image that another image shows, as fractions of its width and height."""

    left: float
    top: float
    width: float
    height: float
    misfit_levels: float

    def in_pixels(self, width_px: int, height_px: int) -> tuple[int, int, int, int]:
        """Left, top, width and height [px]."""
        return (
            round(self.left * width_px),
            round(self.top * height_px),
            round(self.width * width_px),
            round(self.height * height_px),
        )


def find_crop(part: np.ndarray, whole: np.ndarray) -> Crop:
    """Where ``whole`` shows what ``part`` shows, of any size from a half to all of it.

    Both are small RGB images [h, w, 3] of one size. The place is found by normalised correlation at
    each size, the size by the misfit of the colours there; then again in finer steps.
    """
    coarse = np.arange(1.0 - CROP_STEP, MIN_CROP - 1e-9, -CROP_STEP)
    start = Crop(0.0, 0.0, 1.0, 1.0, misfit_levels(part, whole))
    shrunk = thumb(part, THUMB_PX), thumb(whole, THUMB_PX)
    best = _best_of_sizes(*shrunk, coarse, start)
    if best is start or part.shape == shrunk[0].shape:
        return best
    width = best.width
    fine = np.arange(width - CROP_STEP, width + CROP_STEP, CROP_STEP / 4)
    return _best_of_sizes(part, whole, fine[fine < 1], start)


def _best_of_sizes(part: np.ndarray, whole: np.ndarray, shares: np.ndarray, start: Crop) -> Crop:
    height, width = whole.shape[:2]
    smooth = cv2.GaussianBlur(whole, (0, 0), 1.0)
    best = start
    for share in shares:
        size = (max(8, round(width * share)), max(8, round(height * share)))
        template = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
        # Each channel without its mean: the lights of the two need not be alike.
        score = cv2.matchTemplate(smooth, template, cv2.TM_CCOEFF_NORMED)
        _, _, _, (u, v) = cv2.minMaxLoc(score)
        found = whole[v : v + size[1], u : u + size[0]]
        misfit = misfit_levels(template, found)
        if misfit < best.misfit_levels:
            best = Crop(u / width, v / height, size[0] / width, size[1] / height, misfit)
    return best
