# SPDX-License-Identifier: Apache-2.0
"""Images made small, to look at what is smooth in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

THUMB_PX = 160
"""Longer side of the small images."""
BLOCKS = 2000
"""Blocks of an image's pixels, about so many, that tell its light and its sensor."""
USABLE_SHARE = 0.5
"""Part of a block's pixels that have to count for its mean to do so."""


def thumb(image: np.ndarray, longer_px: int = THUMB_PX) -> np.ndarray:
    """The image made small by area averaging, float32, shape [h, w, 3]."""
    scale = min(1.0, longer_px / max(image.shape[:2]))
    size = (max(8, round(image.shape[1] * scale)), max(8, round(image.shape[0] * scale)))
    return resized(image, size).astype(np.float32)


def resized(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Means over blocks of pixels; ``size`` is width and height."""
    if image.shape[1::-1] == size:
        return image
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


@dataclass(frozen=True)
class SmallImage:
    """Means of an image's blocks over the pixels that count."""

    levels: np.ndarray
    """Means, float32, shape [h, w, 3]; 0 where no pixel counts."""
    share: np.ndarray | None
    """Part of each block's pixels that count, shape [h, w]; None for all."""
    shape_px: tuple[int, int]
    """Height and width of the image [px]."""

    @classmethod
    def of(
        cls, image: np.ndarray, mask: np.ndarray | None = None, longer_px: int = THUMB_PX
    ) -> SmallImage:
        """An image [height_px, width_px, 3] made small; ``mask`` tells the pixels that count."""
        levels = np.asarray(image, np.float32)
        shape = (image.shape[0], image.shape[1])
        if mask is None or mask.all():
            return cls(thumb(levels, longer_px), None, shape)
        share = thumb(mask.astype(np.float32), longer_px)
        counted = cv2.copyTo(levels, mask.astype(np.uint8))
        return cls(_mean(thumb(counted, longer_px), share), share, shape)

    @cached_property
    def blocks(self) -> SmallImage:
        """The same with about ``BLOCKS`` blocks, or as it is where it has fewer."""
        height, width = self.levels.shape[:2]
        times = max(1, round((height * width / BLOCKS) ** 0.5))
        return self if times == 1 else self.smaller((round(width / times), round(height / times)))

    def smaller(self, size: tuple[int, int]) -> SmallImage:
        """The same with larger blocks, so many along a row and a column."""
        if self.share is None:
            return SmallImage(resized(self.levels, size), None, self.shape_px)
        share = resized(self.share, size)
        total = resized(self.levels * self.share[..., None], size)
        return SmallImage(_mean(total, share), share, self.shape_px)

    @cached_property
    def usable(self) -> np.ndarray:
        """Blocks of whose pixels enough count, bool, shape [h, w]."""
        if self.share is None:
            return np.ones(self.levels.shape[:2], dtype=bool)
        return self.share >= USABLE_SHARE

    @property
    def reach(self) -> np.ndarray:
        """Places of the middles of the last blocks along a row and a column, where that of the
        image's last pixel is 1 and of its first one -1, shape [2]."""
        full, small = np.array(self.shape_px[::-1]), np.array(self.levels.shape[1::-1])
        return (full - full / small) / np.maximum(full - 1, 1)


def _mean(total: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Means of sums over blocks, 0 where no pixel counts."""
    return total / np.maximum(share, 1e-6)[..., None]
