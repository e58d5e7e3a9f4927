# SPDX-License-Identifier: Apache-2.0
"""Frames, lengths and cameras of other projects.

Their frames are rotations of the gel frame (x right, y down in the image, z out of the gel).
All are proper: a mesh that was mirrored instead would swap left and right in every image.

Their renderers know no refraction. They show the right extent at the right angle of view only from
the apparent distance: focal length times mm/px, which is nearer than the lens really is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from taccel_lab.camera.gel_camera import apparent_distance_mm

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile

T = TypeVar("T")


def m_from_mm(value_mm: T) -> T:
    """Millimetres to metres."""
    # Division by a power of ten is correctly rounded; a product with 1e-3 is not (1e-3 is inexact),
    # so 2.0 mm becomes exactly the double nearest to 0.002 m.
    return value_mm / 1000.0  # type: ignore[operator]


LINK_FROM_GEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""x out of the gel, y left and z up in the image: the body axes of ROS (REP 103) and of TACTO, for
which the gel frame is the optical one."""

TACCEL_FROM_GEL = np.diag([1.0, -1.0, -1.0])
"""Half a turn about x: Taccel's pads are touched from -z, with the contact face at z = 0."""


def turn(rotation: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points or directions [..., 3] in the frame that ``rotation`` leads to."""
    return np.asarray(points, dtype=np.float64) @ rotation.T


def euler_xyz(rotation: np.ndarray) -> tuple[float, float, float]:
    """Angles [rad] about the fixed axes x, y, z in turn, ``R = Rz Ry Rx``: URDF's rpy, TACTO's
    orientation and scipy's "xyz"."""
    from scipy.spatial.transform import Rotation

    roll, pitch, yaw = Rotation.from_matrix(rotation).as_euler("xyz")
    return float(roll), float(pitch), float(yaw)


@dataclass(frozen=True)
class EffectiveCamera:
    """The camera in air that sees the gel as the real one does through window and gel: a pinhole
    without distortion, its principal point in the middle of the image."""

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
