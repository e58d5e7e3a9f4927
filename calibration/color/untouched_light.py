# SPDX-License-Identifier: Apache-2.0
"""The light of a frame by the pixels beside its contact, which no score of the contact reaches."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.color.evaluate import crop_slices
from taccel_lab.calibration.light.fit import PRIOR_SIGMA, enough_pixels, fit_light
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.geometry import PixelGrid

NEAREST_RADII = 2.0
"""No pixel nearer than this many contact radii tells the light."""


def light_beside(
    frame: np.ndarray,
    background: np.ndarray,
    circle: ContactCircle,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
) -> LightDrift:
    """Gain, offset and gradient of ``frame`` against ``background`` beside its contact.

    Images are RGB levels, shape [height_px, width_px, 3]; masked pixels are left out. A contact
    that fills its frame leaves nothing to tell the light by, which then counts as unchanged.
    """
    beside = beside_pixels(circle, grid, mask)
    if enough_pixels(beside):
        return fit_light(frame, background, beside)
    unknown = np.tile(np.diag(PRIOR_SIGMA**2), (3, 1, 1))
    return LightDrift(np.ones(3), np.zeros(3), covariance=unknown)


def noise_floor_l1(
    frame: np.ndarray,
    background: np.ndarray,
    circle: ContactCircle,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
) -> float:
    """Mean absolute difference of a frame from the background in its light beside the contact
    [levels]; NaN where the contact leaves nothing."""
    beside = beside_pixels(circle, grid, mask)
    if not beside.any():
        return float("nan")
    shown = light_beside(frame, background, circle, grid, mask).apply(background)
    return float(np.abs(frame.astype(np.float64) - shown)[beside].mean())


def beside_pixels(
    circle: ContactCircle, grid: PixelGrid, mask: np.ndarray | None = None
) -> np.ndarray:
    """Usable pixels beyond 2 contact radii and outside the crop that scores are taken in; bool,
    shape [height_px, width_px]."""
    beside = circle.distance_px(grid) > NEAREST_RADII * circle.radius_px
    beside[crop_slices(circle, grid)] = False
    return beside if mask is None else beside & mask
