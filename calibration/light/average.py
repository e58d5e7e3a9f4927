# SPDX-License-Identifier: Apache-2.0
"""Averages of images in one light, where each of them counts only where it is untouched.

A median of each pixel would keep out what one of the images shows besides, a second contact or a
hand, but it is noisier than the mean by a quarter (sqrt(pi / 2) for many images). In a robust mean
the median only says which image is off where: the smoothed difference from it, over all channels,
has to stand out of its own scatter (Tukey's biweight, as in ``fit``, beyond its reach). Smoothing
leaves a sixth of a pixel's noise, so that weak but wide things are found, and the weights hardly
depend on the noise of the pixel that they weigh: the noise is that of the plain mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.light.fit import BIWEIGHT, MIN_SCALE_LEVELS
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.calibration.light.smoothing import smoothed
from taccel_lab.calibration.robust_spread import spread_of_lengths

SMOOTHING_PX = 2.0
MIN_WEIGHT = 0.1
"""Sum of weights below which no two images agree on a pixel."""
ROWS_AT_ONCE = 64


def average_background(
    background: np.ndarray,
    frames: Sequence[np.ndarray],
    untouched: Sequence[np.ndarray],
    drifts: Sequence[LightDrift],
    mask: np.ndarray | None = None,
) -> np.ndarray:
    """Robust mean of the background and the drift-free untouched parts of frames, float32 levels.

    Where a single frame and the background disagree, the background is kept; with more, what most
    of them show. All images are RGB, shape [height_px, width_px, 3]; ``untouched`` says of each
    frame where it shows untouched gel, bool, shape [height_px, width_px]. Where ``mask`` is false
    the background is kept too.
    """
    images = [np.asarray(background, np.float32)]
    usable = np.ones(background.shape[:2], dtype=bool) if mask is None else mask
    seen = [usable]
    for frame, flat, drift in zip(frames, untouched, drifts, strict=True):
        images.append(drift.remove(frame.astype(np.float32)).astype(np.float32))
        seen.append(usable & flat)
    averaged = robust_mean(images, seen, images[0])
    return np.clip(averaged, 0.0, 255.0).astype(np.float32)


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
    scale = spread_of_lengths(every, 3) if len(every) else 0.0
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


@dataclass
class RunningMean:
    """Mean and spread of drift-free images over the frames that see each pixel."""

    total: np.ndarray
    squares: np.ndarray
    count: np.ndarray

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> RunningMean:
        """Of no image yet; ``shape`` is [height_px, width_px, 3]."""
        return cls(np.zeros(shape), np.zeros(shape), np.zeros(shape[:2]))

    def add(self, image: np.ndarray, seen: np.ndarray) -> None:
        """Take an image in where it was ``seen``."""
        values = np.where(seen[..., None], image, 0.0).astype(np.float64)
        self.total += values
        self.squares += values**2
        self.count += seen

    def mean(self, otherwise: np.ndarray) -> np.ndarray:
        """Mean [levels]; ``otherwise`` where no image saw the pixel."""
        count = np.maximum(self.count, 1)[..., None]
        return np.where(self.count[..., None] > 0, self.total / count, otherwise)

    def noise(self) -> np.ndarray:
        """Standard deviation between images, the channels' root mean square, shape [height, width];
        NaN where fewer than 3 images saw the pixel."""
        count = self.count[..., None]
        with np.errstate(invalid="ignore", divide="ignore"):
            variance = (self.squares - self.total**2 / count) / (count - 1)
        found = np.sqrt(np.maximum(variance, 0).mean(axis=-1))
        return np.where(self.count >= 3, found, np.nan)
