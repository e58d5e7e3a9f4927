# SPDX-License-Identifier: Apache-2.0
"""The camera in air that sees the gel as the real one does through window and gel.

Renderers without refraction show the right extent at the right angle of view only from the
apparent distance: focal length times mm/px, which is nearer than the lens really is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.camera.gel_camera import apparent_distance_mm
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.units import m_from_mm


@dataclass(frozen=True)
class EffectiveCamera:
    """A pinhole without distortion, its principal point in the middle of the image."""

    position_mm: np.ndarray
    """Centre of projection in the gel frame [mm], shape [3]."""
    gel_from_camera: np.ndarray
    """Rotation; the camera looks along its +z, x right, y down."""
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float

    @property
    def fov_y_rad(self) -> float:
        return float(2 * np.arctan(self.height_px / (2 * self.fy_px)))

    @property
    def distance_m(self) -> float:
        """Distance from the centre of projection to the gel along the optical axis."""
        return float(m_from_mm(-self.position_mm[2] / self.gel_from_camera[2, 2]))


def image_center_mm(profile: SensorProfile) -> np.ndarray:
    """Gel xy under the middle of the tactile image [mm], shape [2]."""
    grid = profile.grid()
    return grid.gel_from_pixel(np.array([(grid.width_px - 1) / 2, (grid.height_px - 1) / 2]))


def effective_camera(profile: SensorProfile) -> EffectiveCamera | None:
    """The camera of the profile's optics block; None without one."""
    if profile.optics is None:
        return None
    grid = profile.grid()
    distance_mm = apparent_distance_mm(profile.optics, profile)
    rotation = profile.optics.camera().gel_from_camera()
    axis = rotation[:, 2]
    center = np.append(image_center_mm(profile), 0.0)
    return EffectiveCamera(
        position_mm=center - distance_mm * axis,
        gel_from_camera=rotation,
        width_px=grid.width_px,
        height_px=grid.height_px,
        fx_px=distance_mm / grid.mm_per_px_x,
        fy_px=distance_mm / grid.mm_per_px_y,
    )
