# SPDX-License-Identifier: Apache-2.0
"""Whether images show the same gel through the same optics: misfit and channel order.

All comparisons are of small images in one light, which takes out exposure and white balance, and by
medians, which a contact on a part of the gel does not move.
"""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from taccel_lab.calibration.frame_light import fit_light

THUMB_PX = 160
"""Longer side of the small images."""
FITTED_PIXELS = 5000
"""Pixels that a fit of the light takes, evenly picked."""
OTHER_FRAMING_LEVELS = 5.0
"""Misfit from which two images are not of the same gel in the same framing."""
CLEAR_GAIN = 2.0
"""One picture is nearer than another when its misfit is this many times smaller."""
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
