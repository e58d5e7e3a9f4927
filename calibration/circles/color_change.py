# SPDX-License-Identifier: Apache-2.0
"""The colour change of a press: what the light's drift does not explain, smoothed, pixels square.

Contacts are looked for at one size (``WorkingSize``). The search knows a contact by parts of the
image's shorter side, from its smoothing (1/240) to the specks that it opens (1/45), and its limits
were chosen on pictures of 240 to 480 rows. More rows tell it nothing more, and cost it the fourth
power of their number. Blocks of ``factor`` x ``factor`` pixels become one, their mean; a contact's
circle comes back in the camera's own pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.frame_light import LightDrift, fit_light, smoothed, without_light
from taccel_lab.geometry import PixelGrid

SMOOTHING_SHARE = 1 / 240
"""Standard deviation of the smoothing, as a part of the image's shorter side."""
SUNK_RADII = 2.0
"""The gel around a contact sinks notably up to this many contact radii."""
SHORTER_PX = 480
"""Least pixels that pictures keep along their shorter side."""


@dataclass(frozen=True)
class ColorChange:
    """One press against the background."""

    change: np.ndarray
    """Smoothed colour change [levels], float32, shape [rows, width_px, 3]: rows are resampled so
    that pixels are square and a round contact is a circle."""
    mask: np.ndarray | None
    """Pixels whose smoothed change rests on usable ones, shape [rows, width_px]; None: all."""
    drift: LightDrift

    def strength(self) -> np.ndarray:
        """Size of the colour change [levels], 0 where masked, shape [rows, width_px]."""
        size = np.linalg.norm(self.change, axis=-1)
        return size if self.mask is None else np.where(self.mask, size, 0.0)

    @property
    def grid(self) -> PixelGrid:
        """The grid of its square pixels, each as wide as 1."""
        rows, columns = self.change.shape[:2]
        return PixelGrid(columns, rows, 1.0, 1.0)


def smoothing_px(image: np.ndarray) -> float:
    """Standard deviation of the smoothing of an image's change [px]."""
    return float(np.clip(min(image.shape[:2]) * SMOOTHING_SHARE, 0.7, 4.0))


def color_change(
    image: np.ndarray,
    background: np.ndarray,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
    light_by: np.ndarray | None = None,
    drift: LightDrift | None = None,
) -> ColorChange:
    """Drift-free smoothed difference of ``image`` to ``background``.

    Both are RGB levels, shape [height_px, width_px, 3]; pixels where ``mask`` is false have no
    effect. A ``drift`` that is not given is that of the whole image, most of which shows untouched
    gel, or without a gradient that of the pixels ``light_by``, bool, shape [height_px, width_px].
    """
    if mask is not None and mask.all():
        mask = None
    sigma = smoothing_px(image)
    drift = drift or fit_light(
        image, background, mask if light_by is None else light_by, gradient=light_by is None
    )
    change = smoothed(without_light(image, background, drift), mask, sigma)
    near = None
    if mask is not None:
        # A sample next to masked pixels rests on fewer; one among them on none.
        near = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma) > 0.5
        near = square_pixels(near.astype(np.uint8), grid, cv2.INTER_NEAREST) > 0
    return ColorChange(square_pixels(change, grid), near, drift)


def square_pixels(
    picture: np.ndarray, grid: PixelGrid, interpolation: int = cv2.INTER_LINEAR
) -> np.ndarray:
    """A picture of ``grid`` with its rows resampled, so that a round contact is a circle."""
    ratio = grid.mm_per_px_y / grid.mm_per_px_x
    if abs(ratio - 1) <= 1e-6:
        return picture
    size = (picture.shape[1], max(2, round(picture.shape[0] * ratio)))
    return cv2.resize(picture, size, interpolation=interpolation)


@dataclass(frozen=True)
class WorkingSize:
    """How pictures of one grid are shrunk, and circles brought back."""

    whole: PixelGrid
    """The grid of the camera's pixels."""

    @cached_property
    def factor(self) -> int:
        """Pixels of the camera along each side of one that is worked with."""
        return max(1, min(self.whole.height_px, self.whole.width_px) // SHORTER_PX)

    @cached_property
    def grid(self) -> PixelGrid:
        """The pixels that are worked with: their number and proportions. Its scale stays that of
        the camera's pixels. What fills no block at the right and lower border is left out."""
        return PixelGrid(
            self.whole.width_px // self.factor,
            self.whole.height_px // self.factor,
            self.whole.mm_per_px_x,
            self.whole.mm_per_px_y,
        )

    def length_px(self, length_mm: float) -> float:
        """A length along x in pixels that are worked with."""
        return length_mm / self.whole.mm_per_px_x / self.factor

    def picture(self, image: np.ndarray) -> np.ndarray:
        """Means of the blocks of an image, shape [height_px, width_px(, channel)] in and out."""
        if self.factor == 1:
            return image
        height, width = self.grid.height_px * self.factor, self.grid.width_px * self.factor
        size = (self.grid.width_px, self.grid.height_px)
        return cv2.resize(image[:height, :width], size, interpolation=cv2.INTER_AREA)

    def mask(self, mask: np.ndarray | None) -> np.ndarray | None:
        """Blocks all of whose pixels may be used, bool, [height_px, width_px]."""
        if mask is None:
            return None
        return self.picture(mask.astype(np.float32)) > 1 - 0.5 / self.factor**2

    def enlarged(self, picture: np.ndarray) -> np.ndarray:
        """A picture of the working size, as large as the camera's."""
        size = (self.whole.width_px, self.whole.height_px)
        return cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)

    def circle(self, circle: ContactCircle) -> ContactCircle:
        """A circle of the camera's pixels, in those that are worked with."""
        return _scaled(circle, 1 / self.factor)

    def whole_circle(self, circle: ContactCircle) -> ContactCircle:
        """A circle of the pixels that are worked with, in the camera's."""
        return _scaled(circle, float(self.factor))


def _scaled(circle: ContactCircle, factor: float) -> ContactCircle:
    """Borders of pixels, not their centres, lie at whole multiples."""
    if factor == 1:
        return circle
    return ContactCircle(
        (circle.u_px + 0.5) * factor - 0.5,
        (circle.v_px + 0.5) * factor - 0.5,
        circle.radius_px * factor,
    )
