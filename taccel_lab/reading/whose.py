# SPDX-License-Identifier: Apache-2.0
"""Whether an image can be of the sensor that a background is of, in place and in which light.

A press leaves a part of the image as it was, but for a gain and an offset of each channel. Where
not even a quarter of the pixels is, or where the light has gone, or where the image fits the
background better with its channels or sides exchanged, whatever is read from it means nothing.

Dust, scratches, dots and the gel's edge stand still until somebody puts the gel back or turns the
lens. What is smooth of both images is taken off; the peak of their normalised cross-spectrum tells
the shift (Kuglin and Hines, Proc. IEEE Conf. Cybernetics and Society, 1975, 163-165).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from taccel_lab.reading.light import LightDrift, fit_light, lattice_pixels, smoothed

QUARTER = 0.25
MOST_LEVELS = 12.0
"""Most that the quarter of the pixels nearest to the background may be off by, once the light is
alike [levels]. Twice the largest of 72 presses of a GelSight Mini and a DIGIT (FOTS), 6.0; presses
of two sensors that it was not chosen on have 3.0 (RVSATHU) and 1.2 (9DTact) at most, backgrounds of
other sensors 15 to 200."""
LEAST_GAIN, MOST_GAIN = 0.25, 4.0
"""Light outside this share of the background's is rejected; presses have 0.8 to 1.5."""
CLEARLY = 3.0
"""An image whose channels or sides are exchanged fits the background better by this factor."""
_LEAST_LEVELS = 3.0
"""Differences below this are noise."""

_EXCHANGED: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "with red and blue exchanged (BGR for RGB?)": lambda image: image[..., ::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored top to bottom": lambda image: image[::-1],
}
SAME_PATTERN = 0.25
"""Part of the background's own variation that may be left once the light is alike, where both show
the same gel: frames of one unit leave 0.01 to 0.1, those of two units of a kind 0.4 to 1.5."""
MOST_PX = 3.0
"""Shift of a picture of 480 rows that readings bear: 9 px make a contact 47 % wider."""
ROWS = 480
GRAIN_SHARE = 1 / 40
"""What is smooth over more than this part of the shorter side is light, not pattern."""
ALIKE = 0.4
"""Correlation of the patterns from which on they are the same one."""
BETTER = 0.2
"""How much better they agree shifted than as they are."""


def unlike(
    image: np.ndarray, background: np.ndarray, light: LightDrift, mask: np.ndarray | None = None
) -> str | None:
    """Why an image is not of the background's sensor, or None.

    Args:
        image: RGB levels, float, shape [height, width, 3].
        background: Untouched sensor, the same.
        light: Of the image against the background (``fit_light``).
        mask: Pixels that count, bool, shape [height, width].
    """
    gain = np.asarray(light.gain, dtype=float)
    if not ((gain > LEAST_GAIN) & (gain < MOST_GAIN)).all():
        if np.ptp(image.reshape(-1, image.shape[-1]), axis=0).max() < 1.0:
            return "it is of one colour"
        return (
            f"its light is {gain.min():.2g} to {gain.max():.2g} times the background's in the "
            f"channels; {LEAST_GAIN:g} to {MOST_GAIN:g} can be read"
        )
    rows, columns = lattice_pixels(np.ones(image.shape[:2], bool) if mask is None else mask)
    own, known = image[rows, columns], background[rows, columns]
    straight = _off(own, known)
    if straight > _LEAST_LEVELS:
        for what, exchange in _EXCHANGED.items():
            if straight > CLEARLY * _off(exchange(image)[rows, columns], known):
                return f"it fits the background {what}"
    height, width = image.shape[:2]
    off = _off(light.at(rows * width + columns, height, width).remove(own), known)
    if off > MOST_LEVELS:
        return (
            f"three quarters of its pixels differ from the background by more than {off:.0f} "
            f"levels, whatever the light; at most {MOST_LEVELS:g} is a press"
        )
    return None


def _off(pixels: np.ndarray, background: np.ndarray) -> float:
    """Largest difference of a channel, of the quarter of pixels [n, 3] nearest to the background's
    ones."""
    return float(np.quantile(np.abs(pixels - background).max(axis=-1), QUARTER))


def light_of_background(
    background: np.ndarray, known: np.ndarray, mask: np.ndarray | None = None
) -> LightDrift:
    """Light of ``background`` against that of the profile, RGB levels [height, width, 3].

    Of one gel on two days it is gain, offset and gradient. Of another unit, whose lamps throw
    another pattern, it is the gain of each channel's mean: a lamp that is brighter by a part makes
    the untouched gel and the colours of a slope brighter by that part.
    """
    counted = slice(None) if mask is None else mask
    means = [image[counted].reshape(-1, 3).mean(axis=0) for image in (background, known)]
    ratio = np.maximum(means[0], 1.0) / np.maximum(means[1], 1.0)
    # What a background does not tell, an even one above all, is a lamp's brightness, not an offset.
    light = fit_light(background, known * ratio, mask)
    light = replace(light, gain=light.gain * ratio)
    left = background - light.apply(known)
    own = known - np.median(known, axis=(0, 1))
    spread, whole = (float(np.median(np.abs(part[counted]))) for part in (left, own))
    if spread <= SAME_PATTERN * whole:
        return light
    return LightDrift(ratio, np.zeros(3))


def pattern_shift(
    image: np.ndarray, background: np.ndarray, mask: np.ndarray | None = None
) -> tuple[float, float] | None:
    """How far the pattern of ``image`` lies right of and below that of ``background`` [px]; None
    where it lies there, or where there is too little of one to tell.

    Both are RGB levels in one light, shape [height_px, width_px, 3].
    """
    import cv2

    sigma = max(GRAIN_SHARE * min(image.shape[:2]), 1.0)
    seen, known = (_grain(picture, mask, sigma) for picture in (image, background))
    window = cv2.createHanningWindow(seen.shape[::-1], cv2.CV_32F)
    (right, down), _ = cv2.phaseCorrelate(known * window, seen * window)
    if max(abs(right), abs(down)) <= MOST_PX * min(image.shape[:2]) / ROWS:
        return None
    moved = np.roll(known, (round(down), round(right)), (0, 1))
    shifted, straight = (_correlation(seen, other, sigma) for other in (moved, known))
    if shifted < ALIKE or shifted < straight + BETTER:
        return None
    return float(right), float(down)


def _grain(picture: np.ndarray, mask: np.ndarray | None, sigma: float) -> np.ndarray:
    """Fine structure of the mean of the channels [levels], float32, shape [height, width]."""
    grey = picture.astype(np.float32) @ np.full(3, 1 / 3, np.float32)
    grain = grey - smoothed(grey, mask, sigma)
    return grain if mask is None else np.where(mask, grain, np.float32(0))


def _correlation(one: np.ndarray, other: np.ndarray, sigma: float) -> float:
    """Median over the picture of the correlation in a neighbourhood: a contact has no pattern of
    the background."""
    import cv2

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), 2 * sigma))

    both = mean(one * other)
    size = np.sqrt(np.maximum(mean(one * one) * mean(other * other), 1e-12))
    return float(np.median(both / size))
