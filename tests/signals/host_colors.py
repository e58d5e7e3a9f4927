# SPDX-License-Identifier: Apache-2.0
"""Images by the colour model's own forward pass on the host: the referee of the device's."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from taccel_lab.signals.color_model import ColorModel


def host_change(
    model: ColorModel, normals: np.ndarray, displacement_mm: np.ndarray, rest_normals: np.ndarray
) -> np.ndarray:
    """Change of colour of all pixels [levels], shape [height_px, width_px, 3]."""
    surface = (normals.reshape(-1, 3), displacement_mm.ravel(), rest_normals.reshape(-1, 3))
    return model.predict_pixels(np.arange(displacement_mm.size), *surface).reshape(normals.shape)


def host_image(model: ColorModel, background_rgb: np.ndarray, *surface: np.ndarray) -> np.ndarray:
    """Levels 0..255 of the image of a surface as ``host_change`` takes it."""
    return np.clip(background_rgb.astype(np.float32) + host_change(model, *surface), 0.0, 255.0)


def face(
    normals: np.ndarray, displacement_mm: np.ndarray, rest_normals: np.ndarray
) -> SimpleNamespace:
    """What ``tactile_image`` needs to know of a pressed gel."""
    heights = {"height_m": 1e-3 * displacement_mm, "rest_height_m": 0 * displacement_mm}
    return SimpleNamespace(**heights, normals=normals, rest_normals=rest_normals)
