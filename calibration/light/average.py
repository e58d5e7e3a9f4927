# SPDX-License-Identifier: Apache-2.0
"""A quieter background from all the frames.

One background image carries the camera's noise into every render; averaging it with the untouched
parts of the training frames removes most of that noise and keeps the gel's own texture. Whatever
else one of the frames shows there, a second contact or a hand, is kept out (``robust_mean``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.light.light import Light
from taccel_lab.calibration.light.robust_mean import robust_mean
from taccel_lab.geometry import PixelGrid

UNTOUCHED_RADII = 2.5
"""Beyond this many contact radii a pixel counts as background."""


def average_background(
    background: np.ndarray,
    frames: Sequence[np.ndarray],
    circles: Sequence[ContactCircle],
    drifts: Sequence[Light],
    grid: PixelGrid,
    mask: np.ndarray | None = None,
) -> np.ndarray:
    """Robust mean of the background and the drift-free untouched parts of frames, float32 levels.

    Where a single frame and the background disagree, the background is kept; with more, what most
    of them show. All images are RGB, shape [height_px, width_px, 3]; where ``mask`` is false the
    background is kept too.
    """
    images = [np.asarray(background, np.float32)]
    usable = np.ones(background.shape[:2], dtype=bool) if mask is None else mask
    seen = [usable]
    for frame, circle, drift in zip(frames, circles, drifts, strict=True):
        images.append(drift.remove(frame.astype(np.float32)).astype(np.float32))
        seen.append(usable & (circle.distance_px(grid) > UNTOUCHED_RADII * circle.radius_px))
    averaged = robust_mean(images, seen, images[0])
    return np.clip(averaged, 0.0, 255.0).astype(np.float32)
