# SPDX-License-Identifier: Apache-2.0
"""Projection of a physical camera: gel points to pixels and pixels to rays, vectorised.

What a lens does not image, behind the camera or where its distortion (``geometry.lens``) has folded
over, is NaN.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.geometry.lens import (
    distort_pinhole,
    fisheye_limit,
    fisheye_radius,
    invert_fisheye,
    undistort_pinhole,
)
from taccel_lab.profile.optical_design import DesignedCamera


class CameraModel:
    """Projects points of the gel frame through one camera, and back to rays."""

    def __init__(self, camera: DesignedCamera) -> None:
        self.camera = camera
        self.gel_from_camera = camera.gel_from_camera()
        """Rotation, shape [3, 3]."""
        self.position_mm = np.array(camera.position_mm, dtype=np.float64)
        count = 4 if camera.model == "fisheye" else 8
        self._coefficients = np.zeros(count)
        self._coefficients[: len(camera.distortion)] = camera.distortion

    def project(self, points_mm: np.ndarray) -> np.ndarray:
        """Pixels (u, v) of points in air, [..., 3] -> [..., 2]; NaN where the lens sees nothing."""
        in_camera = (np.asarray(points_mm, dtype=np.float64) - self.position_mm) @ (
            self.gel_from_camera
        )
        return self.pixels_from_directions(in_camera)

    def pixels_from_directions(self, directions: np.ndarray) -> np.ndarray:
        """Pixels of directions in the camera's own frame, any length, [..., 3] -> [..., 2]."""
        directions = np.asarray(directions, dtype=np.float64)
        if self.camera.model == "fisheye":
            image = self._distort_fisheye(directions)
        else:
            z = directions[..., 2]
            with np.errstate(divide="ignore", invalid="ignore"):
                plane = directions[..., :2] / np.where(z > 0, z, np.nan)[..., None]
            image = distort_pinhole(plane, self._coefficients)
        c = self.camera
        return image * np.array([c.fx_px, c.fy_px]) + np.array([c.cx_px, c.cy_px])

    def directions_from_pixels(self, uv_px: np.ndarray) -> np.ndarray:
        """Unit directions in the camera's own frame, [..., 2] -> [..., 3]; NaN beyond the lens."""
        c = self.camera
        uv = np.asarray(uv_px, dtype=np.float64)
        image = (uv - np.array([c.cx_px, c.cy_px])) / np.array([c.fx_px, c.fy_px])
        if c.model == "fisheye":
            return self._undistort_fisheye(image)
        plane = undistort_pinhole(image, self._coefficients)
        rays = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    def rays(self, uv_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rays that leave the camera through pixels, in the gel frame.

        Args:
            uv_px: Pixels, shape [..., 2].

        Returns:
            Centre of projection [mm], shape [3], and unit directions, shape [..., 3].
        """
        return self.position_mm, self.directions_from_pixels(uv_px) @ self.gel_from_camera.T

    def _distort_fisheye(self, directions: np.ndarray) -> np.ndarray:
        radius = np.hypot(directions[..., 0], directions[..., 1])
        theta = np.arctan2(radius, directions[..., 2])
        bent = np.where(
            theta <= fisheye_limit(self._coefficients),
            fisheye_radius(theta, self._coefficients),
            np.nan,
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(radius > 0, bent / radius, 0.0 * bent)
        return directions[..., :2] * scale[..., None]

    def _undistort_fisheye(self, image: np.ndarray) -> np.ndarray:
        bent = np.linalg.norm(image, axis=-1)
        theta = invert_fisheye(bent, self._coefficients)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(bent > 0, np.sin(theta) / bent, 1.0)
        return np.concatenate([image * scale[..., None], np.cos(theta)[..., None]], axis=-1)


def resized(camera: DesignedCamera, width_px: int, height_px: int) -> DesignedCamera:
    """The same camera with its image scaled to another size; pixel centres are whole numbers."""
    sx, sy = width_px / camera.width_px, height_px / camera.height_px
    return replace(
        camera,
        width_px=width_px,
        height_px=height_px,
        fx_px=camera.fx_px * sx,
        fy_px=camera.fy_px * sy,
        cx_px=(camera.cx_px + 0.5) * sx - 0.5,
        cy_px=(camera.cy_px + 0.5) * sy - 0.5,
    )
