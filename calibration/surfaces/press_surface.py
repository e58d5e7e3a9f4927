# SPDX-License-Identifier: Apache-2.0
"""The gel surface under one press, as the colour calibration needs it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError


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

    def __post_init__(self) -> None:
        shape = self.height_m.shape
        for name, wanted in (
            ("rest_height_m", shape),
            ("normals", (*shape, 3)),
            ("rest_normals", (*shape, 3)),
        ):
            found = getattr(self, name).shape
            if found != wanted:
                raise InputError(f"PressSurface.{name} has shape {found}, expected {wanted}")
        for name in ("height_m", "rest_height_m", "normals", "rest_normals"):
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(f"PressSurface.{name} holds NaN or infinite values")
        if not (math.isfinite(self.contact_radius_px) and self.contact_radius_px > 0):
            raise InputError(
                f"PressSurface.contact_radius_px is {self.contact_radius_px}; a positive number "
                "of pixels is needed"
            )

    def displacement_mm(self) -> np.ndarray:
        """Rise of the face over its rest position [mm], negative below, shape [height, width]."""
        return (self.height_m - self.rest_height_m) * 1e3


def slope_of(normals: np.ndarray) -> np.ndarray:
    """dh/dx and dh/dy of outward normals, shape [..., 2]."""
    return -normals[..., :2] / np.maximum(normals[..., 2:], 1e-3)
