# SPDX-License-Identifier: Apache-2.0
"""Means over the neighbourhood of each pixel in which masked pixels have no part."""

from __future__ import annotations

import cv2
import numpy as np


def smoothed(image: np.ndarray, mask: np.ndarray | None, sigma_px: float) -> np.ndarray:
    """Gaussian mean [sigma_px] over the usable pixels only, float32, same shape as ``image``.

    Where no usable pixel is near, the value is 0.
    """
    if mask is None or mask.all():
        return cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), sigma_px)
    weight = mask.astype(np.float32)
    filled = np.where(mask[..., None], image, 0.0).astype(np.float32)
    total = cv2.GaussianBlur(weight, (0, 0), sigma_px)[..., None]
    spread = cv2.GaussianBlur(filled, (0, 0), sigma_px)
    return np.where(total > 1e-3, spread / np.maximum(total, 1e-3), 0.0).astype(np.float32)
