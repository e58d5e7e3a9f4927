# SPDX-License-Identifier: Apache-2.0
"""The pose of a plane that explains where its points are seen."""

from __future__ import annotations

import cv2
import numpy as np

from taccel_lab.calibration.camera.lens import Lens
from taccel_lab.calibration.robust_fit import fit_robustly, rms
from taccel_lab.errors import InputError

_GRAZING = 0.05
"""Smallest cosine of a ray to the optical axis: beyond, x / z is no use."""


def planar_pose(
    lens: Lens,
    parameters: np.ndarray,
    size_px: tuple[int, int],
    xy_mm: np.ndarray,
    uv_px: np.ndarray,
) -> np.ndarray:
    """Of the poses that a plane's points allow, each refined, the one that misses least:
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
