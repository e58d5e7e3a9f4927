# SPDX-License-Identifier: Apache-2.0
"""The colour change of a press: what the light's drift does not explain, smoothed, pixels square"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.light.fit import fit_light, without_light
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.calibration.light.smoothing import smoothed
from taccel_lab.calibration.robust_spread import spread_about_median
from taccel_lab.geometry import PixelGrid

SMOOTHING_SHARE = 1 / 240
"""Standard deviation of the smoothing, as a part of the image's shorter side."""
SUNK_RADII = 2.0
"""The gel around a contact sinks notably up to this many contact radii."""


@dataclass(frozen=True)
class ColorChange:
    """One press against the background."""

    change: np.ndarray
    """Smoothed colour change [levels], float32, shape [rows, width_px, 3]: rows are resampled so
    that pixels are square and a round contact is a circle."""
    mask: np.ndarray | None
    """Pixels whose smoothed change rests on usable ones, shape [rows, width_px]; None: all."""
    ratio: float
    """mm_per_px_y / mm_per_px_x."""
    smoothing_px: float
    drift: LightDrift

    def strength(self) -> np.ndarray:
        """Size of the colour change [levels], 0 where masked, shape [rows, width_px]."""
        size = np.linalg.norm(self.change, axis=-1)
        return size if self.mask is None else np.where(self.mask, size, 0.0)

    def noise_levels(self, circle: ContactCircle) -> float:
        """Robust standard deviation of the size of the change far from a contact [levels], whose
        circle is in pixels of ``change``."""
        rows, columns = self.change.shape[:2]
        far = circle.far(PixelGrid(columns, rows, 1.0, 1.0), SUNK_RADII, self.mask)
        return spread_about_median(self.strength()[far])


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
    sigma = float(np.clip(min(image.shape[:2]) * SMOOTHING_SHARE, 0.7, 4.0))
    drift = drift or fit_light(
        image, background, mask if light_by is None else light_by, gradient=light_by is None
    )
    change = smoothed(without_light(image, background, drift), mask, sigma)
    near = None
    if mask is not None:
        # A sample next to masked pixels rests on fewer; one among them on none.
        near = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma) > 0.5
    ratio = grid.mm_per_px_y / grid.mm_per_px_x
    if abs(ratio - 1) > 1e-6:
        size = (change.shape[1], max(2, round(change.shape[0] * ratio)))
        change = cv2.resize(change, size, interpolation=cv2.INTER_LINEAR)
        if near is not None:
            near = cv2.resize(near.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return ColorChange(change, near, ratio, sigma, drift)
