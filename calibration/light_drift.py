# SPDX-License-Identifier: Apache-2.0
"""The light of an image against that of another one: gain, offset and a linear gradient.

Ageing lamps, a warm camera and above all automatic white balance change every frame a little. In a
frame without contact each channel follows ``frame = gain * background + offset + gradient``, the
gradient being linear over the image.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from taccel_lab.errors import InputError


@dataclass(frozen=True)
class LightDrift:
    """Light of an image against another's: ``image = gain * other + offset + gradient``."""

    gain: np.ndarray
    """Gain of each channel, shape [3]."""
    offset: np.ndarray
    """Offset of each channel [levels], shape [3]."""
    gradient: np.ndarray = field(default_factory=lambda: np.zeros((3, 2)))
    """Change from the middle to the right and to the lower border [levels], shape [3, 2]."""
    noise_levels: float = 0.0
    """Robust standard deviation of what is left of the smoothed frame, a channel [levels]; 0 when
    not estimated."""
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((3, 4, 4)))
    """Covariance of gain, of the offset at ``level`` [levels], and of the gradient's two parts
    [levels], shape [3, 4, 4]; zero where nothing was fitted."""
    level: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Mean level of each channel that the gain turns about [levels], shape [3]."""

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The background (or a render on it) as the frame's light would show it.

        A gradient needs a whole image, shape [height_px, width_px, 3].
        """
        return image * self.gain + self.offset + self._plane(image)

    def remove(self, image: np.ndarray) -> np.ndarray:
        """The frame as the background's light would show it."""
        return (image - self.offset - self._plane(image)) / self.gain

    def shift(self, level: np.ndarray) -> np.ndarray:
        """Change of a channel of this ``level`` in the middle of the image [levels], shape [3]."""
        return (self.gain - 1) * level + self.offset

    def at(self, pixel_idx: np.ndarray, height_px: int, width_px: int) -> LightDrift:
        """The same for some pixels of an image, counted along rows, shape [n]: the gradient there
        is part of ``offset``, shape [n, 3]."""
        u, v = unit_position(height_px, width_px)
        rows, columns = np.divmod(pixel_idx, width_px)
        there = u[0, columns, None] * self.gradient[:, 0] + v[rows, 0, None] * self.gradient[:, 1]
        return LightDrift(self.gain, self.offset + there, noise_levels=self.noise_levels)

    def terms(self, background: np.ndarray) -> np.ndarray:
        """What a unit of each parameter adds to each channel of an untouched frame, in the order of
        ``covariance``, shape [4, height_px, width_px, 3]."""
        u, v = unit_position(*background.shape[:2])
        found = np.empty((4, *background.shape))
        found[0] = background - self.level
        found[1], found[2], found[3] = 1.0, u[..., None], v[..., None]
        return found

    def covariance_at(self, level: np.ndarray) -> np.ndarray:
        """``covariance`` with the offset taken at another ``level`` of the channels, [3, 4, 4]."""
        moved = np.tile(np.eye(4), (3, 1, 1))
        moved[:, 1, 0] = level - self.level
        return moved @ self.covariance @ moved.transpose(0, 2, 1)

    def _plane(self, image: np.ndarray) -> np.ndarray | float:
        if not self.gradient.any():
            return 0.0
        if image.ndim != 3:
            raise InputError(f"a drift with a gradient needs a whole image, got {image.shape}")
        u, v = unit_position(image.shape[0], image.shape[1])
        return u[..., None] * self.gradient[:, 0] + v[..., None] * self.gradient[:, 1]


def unit_position(height_px: int, width_px: int) -> tuple[np.ndarray, np.ndarray]:
    """-1..1 over the columns [1, width_px] and over the rows [height_px, 1]."""
    return np.linspace(-1, 1, width_px)[None, :], np.linspace(-1, 1, height_px)[:, None]
