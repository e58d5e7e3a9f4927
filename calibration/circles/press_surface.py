# SPDX-License-Identifier: Apache-2.0
"""The gel surface under one press, as the colour calibration needs it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class BallSurface:
    """Deformed and undeformed contact face of the gel on the image's pixel grid, gel frame."""

    height_m: np.ndarray
    """z of the deformed contact face [m], shape [height_px, width_px]."""
    rest_height_m: np.ndarray
    """z of the undeformed contact face [m], shape [height_px, width_px]."""
    normals: np.ndarray
    """Outward unit normals of the deformed face, shape [height_px, width_px, 3]."""
    rest_normals: np.ndarray
    """Outward unit normals of the undeformed face, shape [height_px, width_px, 3]."""
    contact_radius_px: float
    """Radius of the contact, in columns [px]."""
    depth_mm: float
    """Travel of the indenter past first touch [mm]."""
    provider: str
    """What made the surface."""

    def displacement_mm(self) -> np.ndarray:
        """Rise of the face over its rest position [mm], negative below, shape [height, width]."""
        return (self.height_m - self.rest_height_m) * 1e3


def slope_of(normals: np.ndarray) -> np.ndarray:
    """dh/dx and dh/dy of outward normals, shape [..., 2]."""
    return -normals[..., :2] / np.maximum(normals[..., 2:], 1e-3)
