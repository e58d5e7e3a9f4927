# SPDX-License-Identifier: Apache-2.0
"""The light of a frame by its pixels far from the contact, which no score of the contact reaches"""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.light.fit import fit_light
from taccel_lab.calibration.light.light import Light
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

FAR_RADII = 3.0
"""Beyond this many contact radii an image is taken as untouched."""
MIN_FAR_PIXELS = 500


def fit_light_beside(
    frame: np.ndarray,
    background: np.ndarray,
    circle: ContactCircle,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
) -> Light:
    """Gain and offset of ``frame`` against ``background`` beyond 3 radii of its contact.

    Images are RGB levels, shape [height_px, width_px, 3]; masked pixels are left out. Raises
    InputError when the contact leaves fewer than 500 pixels.
    """
    reason = too_little_left(circle, grid, mask)
    if reason:
        raise InputError(reason)
    return fit_light(frame, background, _far(circle, grid, mask), gradient=False)


def too_little_left(circle: ContactCircle, grid: PixelGrid, mask: np.ndarray | None = None) -> str:
    """Why the light beside a contact cannot be told; empty where it can."""
    left = int(_far(circle, grid, mask).sum())
    if left >= MIN_FAR_PIXELS:
        return ""
    return (
        f"its contact leaves {left} usable pixels beyond {FAR_RADII:g} radii, at least "
        f"{MIN_FAR_PIXELS} are needed to tell the light of the frame"
    )


def _far(circle: ContactCircle, grid: PixelGrid, mask: np.ndarray | None) -> np.ndarray:
    far = circle.distance_px(grid) > FAR_RADII * circle.radius_px
    return far if mask is None else far & mask
