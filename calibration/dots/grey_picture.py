# SPDX-License-Identifier: Apache-2.0
"""The one picture that dots are looked for in: grey, and its contrast against what is around."""

from __future__ import annotations

import cv2
import numpy as np

from taccel_lab.errors import InputError

MIN_SIZE_PX = 32
_FINE = 6.0
"""Width, in its own pixels, of a Gaussian that is wide enough to be sampled."""
_FLOOR = 0.08
"""Share of the picture's bright level below which the light is too weak to divide by."""


def grey_levels(image: np.ndarray) -> np.ndarray:
    """Mean of the channels [levels], float32, shape [height_px, width_px].

    The mean, not OpenCV's luma: paint changes all channels alike, coloured light one of them.

    Raises:
        InputError: Not an image of one or three channels of at least 32x32 px, or not finite.
    """
    array = np.asarray(image)
    if array.ndim == 3 and array.shape[2] == 3:
        grey = array.astype(np.float32).mean(axis=2)
    elif array.ndim == 2:
        grey = array.astype(np.float32)
    else:
        raise InputError(f"markers need a grey or RGB image, got an array of {array.shape}")
    if min(grey.shape) < MIN_SIZE_PX:
        raise InputError(
            f"an image of {grey.shape[1]}x{grey.shape[0]} px is too small for markers; at least "
            f"{MIN_SIZE_PX}x{MIN_SIZE_PX} px"
        )
    if not np.isfinite(grey).all():
        raise InputError("the image holds levels that are not finite")
    return grey


def bright_level(grey: np.ndarray) -> float:
    """Level that the bright part of the picture has: its 95th percentile, at least 1."""
    return max(float(np.percentile(grey, 95)), 1.0)


def local_contrast(grey: np.ndarray, around_px: float, bright: float) -> np.ndarray:
    """``grey / mean around - 1``: the same for a dot in the light and one in the shade.

    Args:
        grey: Levels, shape [height_px, width_px].
        around_px: Standard deviation of the Gaussian that takes the mean [px].
        bright: ``bright_level`` of the picture; light below 8 % of it is not divided by.
    """
    factor = max(1, int(around_px / _FINE))
    height, width = grey.shape
    # A wide mean needs no fine pixels.
    size = (max(1, width // factor), max(1, height // factor))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA) if factor > 1 else grey
    small = cv2.GaussianBlur(small, (0, 0), around_px / factor, borderType=cv2.BORDER_REPLICATE)
    around = cv2.resize(small, (width, height)) if factor > 1 else small
    return (grey - around) / np.maximum(around, _FLOOR * bright)


def reduced(grey: np.ndarray, factor: int) -> np.ndarray:
    """Means of squares of ``factor`` pixels; what is left over at the right and below is cut off.

    Pixel (u, v) of the reduced picture is the middle of its square: ``(u + 0.5) factor - 0.5``.
    """
    if factor <= 1:
        return grey
    height, width = (side // factor * factor for side in grey.shape)
    size = (width // factor, height // factor)
    return cv2.resize(grey[:height, :width], size, interpolation=cv2.INTER_AREA)
