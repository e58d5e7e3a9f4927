# SPDX-License-Identifier: Apache-2.0
"""Whether an image can be of the sensor that a background is of.

A press leaves a part of the image as it was, but for a gain and an offset of each channel. Where
not even a quarter of the pixels is, or where the light has gone, or where the image fits the
background better with its channels or sides exchanged, whatever is read from it means nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.calibration.light_drift import LightDrift

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


def unlike(
    image: np.ndarray, background: np.ndarray, light: LightDrift, mask: np.ndarray | None = None
) -> str | None:
    """Why an image is not of the background's sensor, or None.

    Args:
        image: RGB levels, float, shape [height, width, 3].
        background: Untouched sensor, the same.
        light: Of the image against the background, without gradient (``fit_light``).
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
    straight = _off(image, background, mask)
    for what, exchange in _EXCHANGED.items():
        if straight > max(CLEARLY * _off(exchange(image), background, mask), _LEAST_LEVELS):
            return f"it fits the background {what}"
    off = _off(light.remove(image), background, mask)
    if off > MOST_LEVELS:
        return (
            f"three quarters of its pixels differ from the background by more than {off:.0f} "
            f"levels, whatever the light; at most {MOST_LEVELS:g} is a press"
        )
    return None


def _off(image: np.ndarray, background: np.ndarray, mask: np.ndarray | None) -> float:
    """Largest difference of a channel, of the quarter of pixels nearest to the background."""
    difference = np.abs(image - background).max(axis=-1)
    return float(np.quantile(difference if mask is None else difference[mask], QUARTER))
