# SPDX-License-Identifier: Apache-2.0
"""Dark dots found in a picture, without being told where they are."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

_DARKER = 0.15


def find_dots(rgb: np.ndarray, radius_px: float) -> np.ndarray:
    """Centres (u, v) of dots that lie whole in a picture [row, column, 3], weighted by how much
    darker they are than the picture around them, [dot, 2]."""
    grey = rgb.astype(np.float64).mean(axis=-1)
    around = ndimage.grey_closing(grey, size=int(4 * radius_px) | 1)
    dark = 1 - grey / np.maximum(around, 1.0)
    dark[dark < _DARKER] = 0.0
    labels = np.zeros(dark.shape, dtype=np.int32)
    numbers = np.arange(1, int(ndimage.label(dark > 0, output=labels)) + 1)  # type: ignore[arg-type]
    area = ndimage.sum(dark > 0, labels, numbers)
    rim = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    whole = ~np.isin(numbers, rim) & (area > 0.4 * np.pi * radius_px**2)
    centers = np.array(ndimage.center_of_mass(dark, labels, numbers[whole]))
    return centers.reshape(-1, 2)[:, ::-1]


def distances_px(found: np.ndarray, markers_px: np.ndarray) -> np.ndarray:
    """From each dot that was found to the nearest marker, [dot]."""
    return np.linalg.norm(found[:, None] - markers_px[None], axis=-1).min(axis=1)
