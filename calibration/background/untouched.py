# SPDX-License-Identifier: Apache-2.0
"""Which pixels of a frame show untouched gel, and averages in one light over those alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.reading.light import LightDrift, fit_light, smoothed, without_light
from taccel_lab.robust_fit import spread_of_lengths

TOUCHED_SIGMAS = 4.0
TOUCHED_LEVELS = 3.0
"""Smallest smoothed change that counts as touched [levels]."""
SMOOTHING_SHARE = 1 / 160
MARGIN_SHARE = 1 / 24
"""Widening of the touched parts, both as parts of the image's shorter side."""
SPECK_SHARE = 1 / 14
"""Parts smaller than this are specks, not contacts, as a part of the shorter side."""
STEADY_LEVELS = 1.5
STEADY_SIGMAS = 1.0
STEADY_SMOOTHING_SHARE = 1 / 40
MIN_MEDIAN_FRAMES = 5
MIN_SEEN = 3
"""Untouched frames that a pixel of a background made of presses needs."""
MAX_RARELY_SEEN = 0.1
"""Share of the image that may be seen by fewer."""

ReadImage = Callable[[], np.ndarray]
ROWS_AT_ONCE = 64


def untouched_pixels(
    frame: np.ndarray, background: np.ndarray, drift: LightDrift, mask: np.ndarray | None = None
) -> np.ndarray:
    """Where ``frame`` shows the background in its own light, bool, shape [height_px, width_px].

    Touched parts are those whose smoothed change stands out of the frame's noise, with a margin;
    specks do not count as touched. Pixels where ``mask`` is false are neither.
    """
    side = min(frame.shape[:2])
    strength, noise = _strength(frame, background, drift, mask, max(side * SMOOTHING_SHARE, 0.7))
    limit = max(TOUCHED_LEVELS, TOUCHED_SIGMAS * noise)
    count, parts, stats, _ = cv2.connectedComponentsWithStats((strength > limit).astype(np.uint8))
    large = stats[:, cv2.CC_STAT_AREA] >= (SPECK_SHARE * side) ** 2
    large[0] = False
    size = 2 * max(1, round(side * MARGIN_SHARE)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    touched = cv2.dilate(large[parts].astype(np.uint8), kernel) > 0 if count > 1 else parts > 0
    return ~touched if mask is None else ~touched & mask


def steady_pixels(
    frame: np.ndarray, background: np.ndarray, drift: LightDrift, mask: np.ndarray | None = None
) -> np.ndarray:
    """Where a frame may be averaged into ``background``: where no shade of a touch is left.

    The gel sinks far beyond a contact, by less and less; averaged over presses that leaves a stain.
    Only untouched pixels count whose surroundings agree with the background to within 1.5 levels,
    or the noise of the frame's light where that is more. What is averaged then is the fine noise.
    """
    sigma = max(min(frame.shape[:2]) * STEADY_SMOOTHING_SHARE, 1.0)
    strength, noise = _strength(frame, background, drift, mask, sigma)
    steady = strength < max(STEADY_LEVELS, min(STEADY_SIGMAS * noise, 2 * STEADY_LEVELS))
    return steady & untouched_pixels(frame, background, drift, mask)


def _strength(
    frame: np.ndarray,
    background: np.ndarray,
    drift: LightDrift,
    mask: np.ndarray | None,
    sigma_px: float,
) -> tuple[np.ndarray, float]:
    """Size of the smoothed change [levels], and its robust standard deviation from zero."""
    change = without_light(frame.astype(np.float32), background, drift)
    strength = np.linalg.norm(smoothed(change, mask, sigma_px), axis=-1)
    usable = strength if mask is None else strength[mask]
    return strength, spread_of_lengths(usable, 3) * np.sqrt(3)


def background_from_presses(
    frames: Sequence[ReadImage], mask: np.ndarray | None = None
) -> np.ndarray:
    """Image of the untouched gel from presses alone, float32 levels, shape [height, width, 3].

    Each pixel is the median over the frames, whose light is first brought to the common one; then
    again over the frames that did not touch it. Raises InputError with fewer than 5 frames, or
    where pixels were touched in nearly all of them.
    """
    if len(frames) < MIN_MEDIAN_FRAMES:
        raise InputError(
            f"no image of the untouched sensor, and {len(frames)} presses are too few to make one "
            f"of: at least {MIN_MEDIAN_FRAMES}. Give background"
        )
    images = [read() for read in frames]
    everywhere = [np.ones(images[0].shape[:2], dtype=bool)] * len(images)
    level, count = median_where_seen(images, everywhere), np.zeros(images[0].shape[:2])
    for _ in range(2):
        # The common light is that of the frames' mean, so that the drifts cancel out.
        drifts = [fit_light(image, level, mask) for image in images]
        seen = [
            untouched_pixels(image, level, drift, mask)
            for image, drift in zip(images, drifts, strict=True)
        ]
        # Half precision is a sixteenth of a level, and all presses are in memory at once.
        steady = [
            np.clip(drift.remove(image.astype(np.float32)), 0, 255).astype(np.float16)
            for image, drift in zip(images, drifts, strict=True)
        ]
        count = np.sum(seen, axis=0)
        level = median_where_seen(steady, seen)
        if not count.all():
            anyhow = median_where_seen(steady, everywhere)
            level = np.where(count[..., None] > 0, level, anyhow)
    rarely = np.asarray(count < MIN_SEEN)
    if mask is not None:
        rarely &= mask
    if rarely.mean() > MAX_RARELY_SEEN:
        raise InputError(
            f"there is no image of the untouched sensor, and all but {MIN_SEEN - 1} of the "
            f"{len(images)} presses touch {rarely.mean():.0%} of it; give background, or presses "
            "spread over the gel"
        )
    return level


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
