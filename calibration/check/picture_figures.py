# SPDX-License-Identifier: Apache-2.0
"""Channels and levels of one picture, whatever it shows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from scipy.fft import rfft2

NAMES = ("red", "green", "blue")
DEAD_LEVELS, ALIVE_LEVELS = 0.5, 2.0
"""Standard deviations of a small picture's channel [levels]: dead below the first while another
one is above the second. Real ones have 5 and more."""
COPIED_SHARE = 0.99
"""Share of the pixels in which two channels agree to a level, from which on one is a copy."""
RANGE_LEVELS, LEVELS_KEPT = 16, 0.5
"""Levels between the 2nd and 98th percentile from which on those in use are counted, and the share
of them below which levels are missing."""

DETAIL_LEVELS, SMOOTH_LEVELS = 0.38, 0.8
"""Amplitude at a wavelength of three to five pixels below which there is no detail, where that of
10 to 20 pixels is above the second [levels]. Rounding alone leaves 0.17 to 0.29."""
LARGEST_STEP, AT_STEPS = 8, 0.95
"""Largest factor of repeated pixels, and the share of all changes that lie at their borders."""
LEAST_PX, MIDDLE_PX = 40, 240
"""Fewest and most rows and columns, about the middle, that tell detail."""


@dataclass(frozen=True)
class PictureFigures:
    """Channels and levels of one picture."""

    spread: np.ndarray
    """Standard deviation of each channel of the small picture [levels], shape [3]."""
    copies: tuple[bool, bool, bool]
    """Whether red and green, green and blue, and blue and red agree."""
    levels_kept: float
    """Least share over the channels of the levels in use."""
    fine_levels: float
    """Amplitude at wavelengths of three to five pixels, noise above all [levels]; NaN of a picture
    too small to tell."""
    is_enlarged: bool
    """Whether it has no detail of single pixels, or repeats them."""

    @classmethod
    def of(cls, image: np.ndarray, small: np.ndarray) -> PictureFigures:
        """Figures of RGB levels, uint8 [height_px, width_px, 3], and of the same made small."""
        step = max(1, min(image.shape[:2]) // 240)
        channels = cv2.split(np.ascontiguousarray(image[::step, ::step]))
        copies = [
            bool((cv2.absdiff(one, channels[(c + 1) % 3]) <= 1).mean() > COPIED_SHARE)
            for c, one in enumerate(channels)
        ]
        spread = cv2.meanStdDev(small)[1][:, 0]
        kept = min(map(_levels_kept, channels))
        grey = mean_of_channels(_middle(image))
        smooth, fine = _detail(grey)
        bare = smooth > SMOOTH_LEVELS and fine < DETAIL_LEVELS
        enlarged = bare or _repeats_lines(grey)
        return cls(spread, (copies[0], copies[1], copies[2]), kept, fine, enlarged)

    @property
    def dead(self) -> tuple[str, ...]:
        """Channels without a picture, where others have one."""
        alive = self.spread.max() > ALIVE_LEVELS
        return tuple(
            n for n, s in zip(NAMES, self.spread, strict=True) if alive and s < DEAD_LEVELS
        )


def mean_of_channels(image: np.ndarray) -> np.ndarray:
    """Mean of the channels of an image [h, w, 3], float32 [h, w]: in a twentieth of the time of
    ``mean``."""
    levels = np.ascontiguousarray(image, dtype=np.float32)
    return cv2.transform(levels, np.full((1, 3), 1.0 / 3.0))


def _levels_kept(channel: np.ndarray) -> float:
    counts = cv2.calcHist([channel], [0], None, [256], [0, 256]).ravel()
    share = np.cumsum(counts) / channel.size
    low, high = (int(np.searchsorted(share, at)) for at in (0.02, 0.98))
    between = counts[low : high + 1]
    return float((between > 0).mean()) if len(between) >= RANGE_LEVELS else 1.0


def _middle(image: np.ndarray) -> np.ndarray:
    top, left = (max(0, (length - MIDDLE_PX) // 2) for length in image.shape[:2])
    return image[top : top + MIDDLE_PX, left : left + MIDDLE_PX]


def _repeats_lines(grey: np.ndarray) -> bool:
    """Say whether nearly all changes of a picture, float32 [h, w], lie at the borders of larger
    pixels."""
    rows = (grey[1:] != grey[:-1]).any(axis=1).astype(int)
    columns = (grey[:, 1:] != grey[:, :-1]).any(axis=0).astype(int)
    return any(
        max(lines[k::step].sum() for k in range(step)) > AT_STEPS * lines.sum()
        for lines in (rows, columns)
        if lines.any()
        for step in range(2, LARGEST_STEP + 1)
    )


def _detail(grey: np.ndarray) -> tuple[float, float]:
    """Amplitudes of a picture, float32 [h, w], at wavelengths of 10 to 20 pixels and of three to
    five [levels]; NaN where it is too small to tell."""
    if min(grey.shape) < LEAST_PX:
        return np.nan, np.nan
    window, bands = _bands(*grey.shape)
    spectrum = np.asarray(rfft2((grey - grey.mean()) * window)).ravel()
    smooth, fine = (float(np.sqrt(np.square(np.abs(spectrum[band])).mean())) for band in bands)
    return smooth, fine


@cache
def _bands(height: int, width: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Window of a picture, float32 [height, width], and which values of its ``rfft2``, counted
    along rows, have wavelengths of 10 to 20 pixels and of three to five."""
    window = np.outer(np.hanning(height), np.hanning(width))
    window /= np.sqrt(np.square(window).sum())
    away = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    smooth, fine = (
        np.flatnonzero((away >= low) & (away < high)) for low, high in ((0.05, 0.1), (0.2, 0.3))
    )
    return window.astype(np.float32), (smooth, fine)
