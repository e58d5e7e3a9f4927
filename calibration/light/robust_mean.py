# SPDX-License-Identifier: Apache-2.0
"""Mean of images of the same scene that something else in view of one of them does not get into.

A median of each pixel would do, but it is noisier than the mean by a quarter (sqrt(pi / 2) for many
images). Here the median only says which image is off where: the smoothed difference from it, over
all channels, has to stand out of its own scatter (Tukey's biweight, as in ``drift``, beyond its
reach). Smoothing leaves a sixth of a pixel's noise, so that weak but wide things are found, and
the weights hardly depend on the noise of the pixel that they weigh: the noise is that of the plain
mean.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.light.fit import BIWEIGHT, MIN_SCALE_LEVELS
from taccel_lab.calibration.light.smoothing import smoothed

SMOOTHING_PX = 2.0
MIN_WEIGHT = 0.1
"""Sum of weights below which no two images agree on a pixel."""
ROWS_AT_ONCE = 64


def median_where_seen(images: Sequence[np.ndarray], seen: Sequence[np.ndarray]) -> np.ndarray:
    """Median of each pixel over the images that see it, float32 levels, NaN where none does.

    Args:
        images: RGB levels, each of shape [height_px, width_px, 3].
        seen: Where each image counts, bool, each of shape [height_px, width_px].
    """
    result = np.empty(images[0].shape, np.float32)
    for top in range(0, len(result), ROWS_AT_ONCE):
        rows = slice(top, top + ROWS_AT_ONCE)
        stack = np.stack([np.asarray(image[rows], np.float32) for image in images])
        shown = np.stack([where[rows] for where in seen])
        stack[~shown] = np.inf
        stack.sort(axis=0)
        count = shown.sum(axis=0)
        low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(stack) - 1)
        middle = [np.take_along_axis(stack, at[None, ..., None], axis=0)[0] for at in (low, high)]
        result[rows] = np.where(count[..., None] > 0, (middle[0] + middle[1]) / 2, np.nan)
    return result


def robust_mean(
    images: Sequence[np.ndarray], seen: Sequence[np.ndarray], otherwise: np.ndarray
) -> np.ndarray:
    """Mean of each pixel over the images that see it and agree there, levels.

    Args:
        images: RGB levels in one light, each of shape [height_px, width_px, 3].
        seen: Where each image counts, bool, each of shape [height_px, width_px].
        otherwise: Levels where no image counts, or where all disagree (two images that do),
            shape [height_px, width_px, 3].
    """
    middle = median_where_seen(images, seen)
    middle = np.where(np.isfinite(middle), middle, otherwise)
    distances = [
        np.linalg.norm(smoothed(image - middle, where, SMOOTHING_PX), axis=-1)
        for image, where in zip(images, seen, strict=True)
    ]
    every = np.concatenate([d[where] for d, where in zip(distances, seen, strict=True)])
    # The median of the norm of three normal variables is 1.538 standard deviations.
    scale = float(np.median(every)) / 1.538 if len(every) else 0.0
    reach = max(np.sqrt(3) * BIWEIGHT * scale, MIN_SCALE_LEVELS)
    total, count = np.zeros(middle.shape), np.zeros(middle.shape[:2])
    for image, where, distance in zip(images, seen, distances, strict=True):
        # Whole up to the reach, so that light which differs a little from frame to frame averages
        # as in a plain mean; what stands out goes to zero as smoothly as the biweight does.
        beyond = np.clip(distance / reach - 1, 0.0, 1.0)
        weight = np.where(where, (1 - beyond**2) ** 2, 0.0)
        total += weight[..., None] * np.where(where[..., None], image, 0.0)
        count += weight
    known = count[..., None] >= MIN_WEIGHT
    return np.where(known, total / np.maximum(count, MIN_WEIGHT)[..., None], otherwise)
