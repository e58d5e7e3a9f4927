# SPDX-License-Identifier: Apache-2.0
"""Averages of images in one light, where each of them counts only where it is untouched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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


@dataclass
class RunningMean:
    """Mean and spread of drift-free images over the frames that see each pixel."""

    total: np.ndarray
    squares: np.ndarray
    count: np.ndarray

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> RunningMean:
        """Mean of no image yet; ``shape`` is [height_px, width_px, 3]."""
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
