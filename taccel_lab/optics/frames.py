# SPDX-License-Identifier: Apache-2.0
"""What a render of one frame gives: the picture, and the light behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PreviewImage:
    """A rendered frame; every array has a leading axis of environments when positions had one."""

    rgb: np.ndarray
    """As the camera would deliver it, uint8, shape [H, W, 3]."""
    linear: np.ndarray
    """Radiance in relative units, float32, shape [H, W, 3]."""
    mask: np.ndarray
    """Pixels that see the contact face, bool, shape [H, W]."""
    points_mm: np.ndarray
    """Seen points in the gel frame [mm], float32, shape [H, W, 3]; NaN outside the mask."""
    normals: np.ndarray
    """Outward unit normals there, float32, shape [H, W, 3]; NaN outside the mask."""


@dataclass(frozen=True)
class LightField:
    """The light on every pixel of a frame, before the coating's colour."""

    vectors: np.ndarray
    """Irradiance vector of each channel, float32, shape [H, W, 3 channels, 3]; its product with
    the inward normal is the irradiance."""
    specular: np.ndarray
    """Radiance of the glossy lobe, float32, shape [H, W, 3]."""
    facing: np.ndarray
    """Light that comes from the coating's side, all channels, shape [H, W]."""
    blocked: np.ndarray
    """The part of it that the face itself shadows, shape [H, W]."""
    points_mm: np.ndarray
    normals: np.ndarray
    rest_mm: np.ndarray
    """Seen points before the gel deformed [mm], shape [H, W, 3]."""
    mask: np.ndarray

    def irradiance(self) -> np.ndarray:
        """Direct light on the coating by channel, shape [H, W, 3]."""
        return np.maximum(-np.einsum("hwcx,hwx->hwc", self.vectors, self.normals), 0.0)
