# SPDX-License-Identifier: Apache-2.0
"""Poses of a plane that explain where its points are seen, to start a refinement from."""

from __future__ import annotations

import cv2
import numpy as np

from taccel_lab.calibration.camera.lens import Lens
from taccel_lab.errors import InputError

_GRAZING = 0.05
"""Smallest cosine of a ray to the optical axis: beyond, x / z is no use."""


def planar_poses(
    lens: Lens,
    parameters: np.ndarray,
    size_px: tuple[int, int],
    xy_mm: np.ndarray,
    uv_px: np.ndarray,
) -> list[np.ndarray]:
    """camera_from_plane (rotation vector, translation in mm) of a plane's points, each [6].

    IPPE (Collins & Bartoli 2014) gives both poses between which a plane seen from afar is
    ambiguous; on a plane that is exactly parallel to the image it may divide by zero, so SQPnP
    (Terzakis & Lourakis 2020), which gives one pose, is asked as well.

    Args:
        lens: Lens model and its ``parameters`` [p] for images of ``size_px``.
        xy_mm: Points on the plane z = 0, shape [n, 2].
        uv_px: Where they are seen, shape [n, 2].

    Raises:
        InputError: Fewer than 4 of the points lie within the lens's field.
    """
    rays = lens.directions(parameters, size_px, uv_px)
    seen = np.isfinite(rays).all(axis=1) & (rays[:, 2] > _GRAZING)
    if seen.sum() < 4:
        raise InputError("fewer than 4 points lie within the lens's field")
    plane = (rays[seen, :2] / rays[seen, 2:]).reshape(-1, 1, 2)
    points = np.column_stack([xy_mm[seen], np.zeros(seen.sum())]).reshape(-1, 1, 3)
    poses = []
    for method in (cv2.SOLVEPNP_IPPE, cv2.SOLVEPNP_SQPNP):
        count, rotations, translations, _ = cv2.solvePnPGeneric(
            points, plane, np.eye(3), None, flags=method
        )
        poses += [
            np.concatenate([np.ravel(rotations[i]), np.ravel(translations[i])])
            for i in range(count)
        ]
    return [pose for pose in poses if np.isfinite(pose).all()]
