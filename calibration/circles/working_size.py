# SPDX-License-Identifier: Apache-2.0
"""The size at which contacts are looked for: pictures of many pixels are shrunk to it.

The search knows a contact by parts of the image's shorter side, from its smoothing (1/240) to the
specks that it opens (1/45), and its limits were chosen on pictures of 240 to 480 rows. More rows
tell it nothing more, and cost it the fourth power of their number. Blocks of ``factor`` x
``factor`` pixels become one, their mean; a contact's circle comes back in the camera's own pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.geometry import PixelGrid

SHORTER_PX = 480
"""Pictures keep at least so many pixels along their shorter side."""


@dataclass(frozen=True)
class WorkingSize:
    """How pictures of one grid are shrunk, and circles brought back."""

    whole: PixelGrid
    """Of the camera's pixels."""

    @cached_property
    def factor(self) -> int:
        """Pixels of the camera along each side of one that is worked with."""
        return max(1, min(self.whole.height_px, self.whole.width_px) // SHORTER_PX)

    @cached_property
    def grid(self) -> PixelGrid:
        """Of the pixels that are worked with: their number and proportions. Its scale stays that
        of the camera's pixels. What fills no block at the right and lower border is left out."""
        if self.factor == 1:
            return self.whole
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
        if mask is None or self.factor == 1:
            return mask
        return self.picture(mask.astype(np.float32)) > 1 - 0.5 / self.factor**2

    def enlarged(self, picture: np.ndarray) -> np.ndarray:
        """A picture of the working size, as large as the camera's."""
        if self.factor == 1:
            return picture
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
