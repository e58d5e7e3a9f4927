# SPDX-License-Identifier: Apache-2.0
"""Images made small, to look at what is smooth in them."""

from __future__ import annotations

import cv2
import numpy as np

THUMB_PX = 160
"""Longer side of the small images."""


def thumb(image: np.ndarray, longer_px: int = THUMB_PX) -> np.ndarray:
    """The image made small by area averaging, float32, shape [h, w, 3]."""
    scale = min(1.0, longer_px / max(image.shape[:2]))
    size = (max(8, round(image.shape[1] * scale)), max(8, round(image.shape[0] * scale)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
