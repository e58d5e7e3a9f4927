# SPDX-License-Identifier: Apache-2.0
"""Lens models that are fitted, from simple to rich, and the pose of a plane that one explains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from taccel_lab.calibration.camera.options import LensName
from taccel_lab.calibration.robust_fit import fit_robustly, rms
from taccel_lab.camera.gel_camera import CameraModel
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import DesignedCamera

_GRAZING = 0.05
"""Smallest cosine of a ray to the optical axis: beyond, x / z is no use."""


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
        fisheye, count = self.name == "fisheye", self.coefficients
        bends = np.zeros(4 if fisheye else 8)
        bends[:count] = parameters[4:]
        project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
        uv, jacobian = project(objects, pose[:3].copy(), pose[3:].copy(), matrix, bends)[:2]
        jacobian = np.asarray(jacobian).reshape(len(objects), 2, -1)
        # OpenCV's columns: of a fisheye f, c, k, pose; of others pose, f, c, k.
        by_pose, first = (jacobian[..., 8:14], 0) if fisheye else (jacobian[..., :6], 6)
        return np.asarray(uv).reshape(-1, 2), jacobian[..., first : first + 4 + count], by_pose

    def camera(
        self,
        parameters: np.ndarray,
        size_px: tuple[int, int],
        position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
        rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    ) -> DesignedCamera:
        """The camera as the profile and the renderer describe it."""
        fx, fy, cx, cy, *bends = (float(v) for v in parameters)
        bends += [0.0] * (self.stored - len(bends))
        return DesignedCamera(
            *size_px, fx, fy, cx, cy, position_mm, rotation, self.camera_kind, tuple(bends)
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
"""Lenses by name, the simplest first: the order of preference among models that predict alike."""


def planar_pose(
    lens: Lens,
    parameters: np.ndarray,
    size_px: tuple[int, int],
    xy_mm: np.ndarray,
    uv_px: np.ndarray,
) -> np.ndarray:
    """The pose, among those that a plane's points allow, each refined, that misses least:
    camera_from_plane as rotation vector and translation [mm], shape [6].

    Args:
        lens: Lens model and its ``parameters`` [p] for images of ``size_px``.
        xy_mm: Points on the plane z = 0, shape [n, 2].
        uv_px: Where they are seen, shape [n, 2].

    Raises:
        InputError: Fewer than 4 of the points lie within the lens's field, or no pose.
    """
    points = np.column_stack([xy_mm, np.zeros(len(xy_mm))])
    starts = _starts(lens.directions(parameters, size_px, uv_px), points)
    poses = [fit_pose(lens, parameters, points, uv_px, start) for start in starts]
    if not poses:
        raise InputError(f"no pose of the plane explains its {len(points)} points")
    return min(poses, key=lambda pose: rms(uv_px - lens.project(points, parameters, pose)))


def fit_pose(
    lens: Lens,
    parameters: np.ndarray,
    points_mm: np.ndarray,
    uv_px: np.ndarray,
    pose: np.ndarray,
    robust: bool = True,
) -> np.ndarray:
    """Pose of points [n, 3] with the lens held fixed, by least squares from ``pose`` [6]."""
    return fit_robustly(
        lambda x: uv_px - lens.project(points_mm, parameters, x),
        pose,
        jacobian=lambda x: -lens.project_with_jacobian(points_mm, parameters, x)[2].reshape(-1, 6),
        robust=robust,
    ).x


def _starts(rays: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    """Poses to start from, each [6], of points [n, 3] that are seen along rays [n, 3].

    IPPE (Collins & Bartoli 2014) gives both poses between which a plane seen from afar is
    ambiguous; on a plane that is exactly parallel to the image it may divide by zero, so SQPnP
    (Terzakis & Lourakis 2020), which gives one pose, is asked as well.
    """
    seen = np.isfinite(rays).all(axis=1) & (rays[:, 2] > _GRAZING)
    if seen.sum() < 4:
        raise InputError("fewer than 4 points lie within the lens's field")
    plane = (rays[seen, :2] / rays[seen, 2:]).reshape(-1, 1, 2)
    poses = []
    for method in (cv2.SOLVEPNP_IPPE, cv2.SOLVEPNP_SQPNP):
        count, rotations, translations, _ = cv2.solvePnPGeneric(
            points[seen].reshape(-1, 1, 3), plane, np.eye(3), None, flags=method
        )
        poses += [
            np.concatenate([np.ravel(rotations[i]), np.ravel(translations[i])])
            for i in range(count)
        ]
    return [pose for pose in poses if np.isfinite(pose).all()]
