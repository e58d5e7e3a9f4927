# SPDX-License-Identifier: Apache-2.0
"""The camera in air that sees the gel as the real one does through window and gel.

Renderers without refraction show the right extent at the right angle of view only from the
apparent distance: focal length times mm/px, which is nearer than the lens really is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    def fov_x_rad(self) -> float:
        return float(2 * np.arctan(self.width_px / (2 * self.fx_px)))

    @property
    def fov_y_rad(self) -> float:
        return float(2 * np.arctan(self.height_px / (2 * self.fy_px)))

    @property
    def distance_m(self) -> float:
        """From the centre of projection to the gel along the optical axis."""
        return float(m_from_mm(-self.position_mm[2] / self.gel_from_camera[2, 2]))


def image_center_mm(profile: SensorProfile) -> np.ndarray:
    """Gel xy under the middle of the tactile image [mm], shape [2]."""
    grid = profile.grid()
    return grid.gel_from_pixel(np.array([(grid.width_px - 1) / 2, (grid.height_px - 1) / 2]))


def effective_camera(profile: SensorProfile) -> EffectiveCamera | None:
    """The camera of the profile's optics block; None without one."""
    if profile.optics is None:
        return None
    camera, grid = profile.optics.camera(), profile.grid()
    # The tactile image may be another size than that the intrinsics belong to.
    fx = camera.fx_px * grid.width_px / camera.width_px
    fy = camera.fy_px * grid.height_px / camera.height_px
    # One distance cannot give both scales when they differ: the mean one, with angles of view that
    # show the right extents from there.
    distance_mm = float(np.sqrt(fx * grid.mm_per_px_x * fy * grid.mm_per_px_y))
    rotation = camera.gel_from_camera()
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
