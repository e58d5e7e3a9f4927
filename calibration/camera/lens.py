# SPDX-License-Identifier: Apache-2.0
"""Lens models that are fitted, from simple to rich, and their projection with derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from taccel_lab.calibration.camera.options import LensName
from taccel_lab.camera.camera_model import CameraModel
from taccel_lab.profile.optical_design import DesignedCamera


@dataclass(frozen=True)
class Lens:
    """One family of lenses; its parameters are fx, fy, cx, cy and the free coefficients."""

    name: LensName
    coefficients: int
    """Free distortion coefficients, the first of OpenCV's order."""
    stored: int
    """Coefficients stored in a profile, the rest of them 0."""

    @property
    def parameter_count(self) -> int:
        """Focal lengths, principal point and free coefficients."""
        return 4 + self.coefficients

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        names = ("k1", "k2", "k3", "k4")
        if self.name in ("pinhole", "rational"):
            names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        return ("fx_px", "fy_px", "cx_px", "cy_px", *names[: self.coefficients])

    @property
    def camera_kind(self) -> Literal["pinhole", "fisheye"]:
        """Name of the model in a profile."""
        return "fisheye" if self.name == "fisheye" else "pinhole"

    def distortion(self, parameters: np.ndarray) -> tuple[float, ...]:
        """Coefficients in OpenCV's order as a profile stores them."""
        values = [float(v) for v in parameters[4:]]
        return tuple(values + [0.0] * (self.stored - len(values)))

    def project(self, points: np.ndarray, parameters: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Pixels [n, 2] of points [n, 3] under ``pose`` (rotation vector, translation)."""
        return self.project_with_jacobian(points, parameters, pose)[0]

    def project_with_jacobian(
        self, points: np.ndarray, parameters: np.ndarray, pose: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels [n, 2] with derivatives by parameters [n, 2, p] and by the pose [n, 2, 6]."""
        fx, fy, cx, cy = parameters[:4]
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        objects = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 1, 3)
        rotation, translation = pose[:3].copy(), pose[3:].copy()
        count = self.coefficients
        if self.name == "fisheye":
            bends = np.zeros(4)
            bends[:count] = parameters[4:]
            uv, jacobian = cv2.fisheye.projectPoints(objects, rotation, translation, matrix, bends)[
                :2
            ]
            jacobian = np.asarray(jacobian).reshape(-1, 2, 15)
            by_parameters = jacobian[:, :, : 4 + count]
            by_pose = jacobian[:, :, 8:14]
        else:
            bends = np.zeros(8)
            bends[:count] = parameters[4:]
            uv, jacobian = cv2.projectPoints(objects, rotation, translation, matrix, bends)[:2]
            jacobian = np.asarray(jacobian).reshape(-1, 2, 18)
            by_parameters = jacobian[:, :, 6 : 10 + count]
            by_pose = jacobian[:, :, :6]
        return np.asarray(uv).reshape(-1, 2), by_parameters, by_pose

    def camera(
        self,
        parameters: np.ndarray,
        size_px: tuple[int, int],
        position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
        rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    ) -> DesignedCamera:
        """The camera as the profile and the renderer describe it."""
        fx, fy, cx, cy = (float(v) for v in parameters[:4])
        return DesignedCamera(
            size_px[0],
            size_px[1],
            fx,
            fy,
            cx,
            cy,
            position_mm,
            rotation,
            self.camera_kind,
            self.distortion(parameters),
        )

    def directions(
        self, parameters: np.ndarray, size_px: tuple[int, int], uv_px: np.ndarray
    ) -> np.ndarray:
        """Unit sight lines [n, 3] of pixels [n, 2] in the camera's frame; NaN beyond the lens."""
        camera = self.camera(parameters, size_px)
        return CameraModel(camera).directions_from_pixels(uv_px)


LENSES: dict[str, Lens] = {
    "k1": Lens("k1", 1, 4),
    "fisheye": Lens("fisheye", 4, 4),
    "pinhole": Lens("pinhole", 5, 5),
    "rational": Lens("rational", 8, 8),
}
"""By name, the simplest first: the order of preference among models that predict alike."""
