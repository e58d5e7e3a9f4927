# SPDX-License-Identifier: Apache-2.0
"""A quieter background from all the frames.

One background image carries the camera's noise into every render; averaging it with the untouched
parts of the training frames removes most of that noise and keeps the gel's own texture.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.background.drift import Drift
from calibration.capture.captures import ContactCircle
from taccel_lab.geometry import PixelGrid

UNTOUCHED_RADII = 2.5
"""Beyond this many contact radii a pixel counts as background."""


def average_background(
    background: np.ndarray,
    frames: Sequence[np.ndarray],
    circles: Sequence[ContactCircle],
    drifts: Sequence[Drift],
    grid: PixelGrid,
) -> np.ndarray:
    """Mean of the background and the drift-free untouched parts of frames, float32 levels.

    All images are RGB, shape [height_px, width_px, 3].
    """
    total = background.astype(np.float64).copy()
    count = np.ones(background.shape[:2])
    for frame, circle, drift in zip(frames, circles, drifts, strict=True):
        untouched = circle.distance_px(grid) > UNTOUCHED_RADII * circle.radius_px
        total[untouched] += drift.remove(frame.astype(np.float64))[untouched]
        count += untouched
    return np.clip(total / count[..., None], 0.0, 255.0).astype(np.float32)
