# SPDX-License-Identifier: Apache-2.0
"""Pixels that dots cover, at rest and in a frame: their colours tell no slope.

A dark dot stands out of the closing of its picture, a maximum and a minimum over a window wider
than the dot (Serra, Image Analysis and Mathematical Morphology, 1982). The lattice of the untouched
picture says that there are dots, and how far apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.dots.marker_picture import MIN_DOTS, find_markers
from taccel_lab.errors import InputError

WINDOW_SHARE = 0.6
"""Window of the closing, as a part of the dots' pitch."""
DARKER = 0.15
"""Part of the light that a dot takes at least."""
MARGIN_SHARE = 0.06
"""Rim around a dot that is covered, too, as a part of the pitch: lenses blur it."""
COARSE_PARTS = 12
"""Dots are narrower than this part of the shorter side: what a first look for them takes."""


@dataclass(frozen=True)
class DotMask:
    """Where dots are."""

    at_rest: np.ndarray
    """Pixels that dots cover in the untouched picture, bool, shape [height_px, width_px]."""
    pitch_px: float

    @classmethod
    def of(cls, untouched: np.ndarray) -> DotMask | None:
        """The dots of an untouched picture, RGB levels, shape [height_px, width_px, 3]; None where
        it shows no lattice of dark ones."""
        import cv2

        coarse = min(untouched.shape[:2]) / COARSE_PARTS / WINDOW_SHARE
        dark = _covered(untouched, coarse).astype(np.uint8)
        if cv2.connectedComponents(dark)[0] <= MIN_DOTS:
            return None
        try:
            found = find_markers(np.clip(untouched, 0, 255).astype(np.uint8))
        except InputError:
            return None
        pitch = float(min(found.layout_px.pitch))
        return cls(_covered(untouched, pitch), pitch)

    def uncovered(self, image: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
        """Pixels that no dot covers, here or at rest, and that ``mask`` counts, bool, [h, w]."""
        free = ~(self.at_rest | _covered(image, self.pitch_px))
        return free if mask is None else free & mask


def _covered(image: np.ndarray, pitch_px: float) -> np.ndarray:
    import cv2

    grey = np.clip(image, 0, 255).astype(np.float32).mean(axis=-1)
    size = 2 * round(0.5 * WINDOW_SHARE * pitch_px) + 1
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    around = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, window)
    dark = (around - grey > DARKER * np.maximum(around, 1.0)).astype(np.uint8)
    rim = 2 * max(1, round(MARGIN_SHARE * pitch_px)) + 1
    return cv2.dilate(dark, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (rim, rim))) > 0
