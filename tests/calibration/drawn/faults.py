# SPDX-License-Identifier: Apache-2.0
"""Faults of real captures, put into RGB or grey levels as floats; only ``quantise`` clips them."""

from __future__ import annotations

import cv2
import numpy as np


def add_noise(image: np.ndarray, sigma_levels: float, rng: np.random.Generator) -> np.ndarray:
    """White noise of the sensor chip."""
    return image + rng.normal(0.0, sigma_levels, image.shape)


def blur(image: np.ndarray, sigma_px: float) -> np.ndarray:
    """Gaussian defocus."""
    return cv2.GaussianBlur(np.asarray(image, dtype=np.float64), (0, 0), sigma_px)


def vignette(image: np.ndarray, strength: float) -> np.ndarray:
    """Light falling off by ``strength`` (0..1) from the middle to the corners, as r^2."""
    height, width = image.shape[:2]
    v, u = np.mgrid[:height, :width]
    radius2 = (2 * u - (width - 1)) ** 2 + (2 * v - (height - 1)) ** 2
    return image * _like(image, 1.0 - strength * radius2 / ((width - 1) ** 2 + (height - 1) ** 2))


def drift(
    image: np.ndarray, gain: np.ndarray | float = 1.0, offset: np.ndarray | float = 0.0
) -> np.ndarray:
    """Gain and offset [levels] of each channel, as ageing LEDs or auto white balance give."""
    return image * np.asarray(gain) + np.asarray(offset)


def add_gradient(image: np.ndarray, levels_u: float, levels_v: float) -> np.ndarray:
    """Light that changes linearly by this much from the middle to the right and lower edge."""
    height, width = image.shape[:2]
    u, v = np.linspace(-1, 1, width)[None, :], np.linspace(-1, 1, height)[:, None]
    return image + _like(image, levels_u * u + levels_v * v)


def add_dust(
    image: np.ndarray,
    count: int,
    rng: np.random.Generator,
    *,
    radius_px: float = 2.0,
    levels: float = -40.0,
) -> np.ndarray:
    """Soft specks at random places."""
    height, width = image.shape[:2]
    v, u = np.mgrid[:height, :width]
    specks = np.zeros((height, width))
    for _ in range(count):
        at = rng.uniform(0, 1, 2) * (width - 1, height - 1)
        specks += np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / (2 * radius_px**2))
    return image + _like(image, levels * np.minimum(specks, 1.0))


def poison(image: np.ndarray, mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Random levels where ``mask`` (pixels that may be used) is false: must have no effect."""
    poisoned = np.array(image, dtype=np.float64)
    poisoned[~mask] = rng.uniform(0, 255, poisoned[~mask].shape)
    return poisoned


def quantise(image: np.ndarray) -> np.ndarray:
    """Whole levels 0..255, as a file stores them."""
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _like(image: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """A grey picture for every channel of the image."""
    return levels[..., None] if image.ndim == 3 else levels
