# SPDX-License-Identifier: Apache-2.0
"""Background: drift of each frame against it, and a quieter one from all the frames.

A camera's white balance and the lamps drift between frames; the affine correction per channel is
fitted where the gel is untouched. One background image carries the camera's noise into every
render; averaging it with the untouched parts of the training frames removes most of that noise
and keeps the gel's own texture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.capture.captures import ContactCircle
from calibration.evaluate import FAR_RADII
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

UNTOUCHED_RADII = 2.5
"""Beyond this many contact radii a pixel counts as background."""
OUTLIER_LEVELS = 20.0
MIN_FAR_PIXELS = 500


@dataclass(frozen=True)
class Drift:
    """Affine change of the background in one frame: ``frame = gain * background + offset``."""

    gain: np.ndarray
    """Gain of each channel, shape [3]."""
    offset: np.ndarray
    """Offset of each channel [levels], shape [3]."""

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The background (or a render on it) as the frame's light would show it."""
        return image * self.gain + self.offset

    def remove(self, image: np.ndarray) -> np.ndarray:
        """The frame as the background's light would show it."""
        return (image - self.offset) / self.gain


def fit_drift(
    frame: np.ndarray,
    background: np.ndarray,
    circle: ContactCircle,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
) -> Drift:
    """Drift of ``frame`` against ``background`` beyond 3 contact radii, per channel.

    Images are RGB levels, shape [height_px, width_px, 3]; masked pixels are left out. Least
    squares, repeated once without pixels that are off by more than 20 levels.
    """
    far = circle.distance_px(grid) > FAR_RADII * circle.radius_px
    if mask is not None:
        far &= mask
    if far.sum() < MIN_FAR_PIXELS:
        raise InputError(
            f"only {int(far.sum())} usable pixels lie beyond {FAR_RADII:g} contact radii; at least "
            f"{MIN_FAR_PIXELS} are needed to fit the background's drift"
        )
    gain, offset = np.ones(3), np.zeros(3)
    for c in range(3):
        x = background[far][:, c].astype(np.float64)
        y = frame[far][:, c].astype(np.float64)
        keep = np.ones(len(x), dtype=bool)
        for _ in range(2):
            spread = x[keep].std()
            if spread > 1.0:
                gain[c], offset[c] = np.polyfit(x[keep], y[keep], 1)
            else:  # A flat background cannot tell gain from offset.
                gain[c], offset[c] = 1.0, float((y - x)[keep].mean())
            close = np.abs(y - gain[c] * x - offset[c]) < OUTLIER_LEVELS
            if close.sum() < MIN_FAR_PIXELS // 2:
                break
            keep = close
    return Drift(gain, offset)


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
        total[untouched] += drift.remove(frame[untouched].astype(np.float64))
        count += untouched
    return np.clip(total / count[..., None], 0.0, 255.0).astype(np.float32)
