# SPDX-License-Identifier: Apache-2.0
"""Models of how the plane of the gel's face appears in the image, each a function of parameters.

Without a calibrated lens, the plane is a homography bent by radial distortion: enough for scale and
rectification, since the focal length cannot be told from a plane that never tilts. With a lens, it
is the pose of the camera, in air or through the flat media in front of the gel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from taccel_lab.calibration.camera.lens import Lens
from taccel_lab.calibration.camera.planar_pose import planar_poses
from taccel_lab.camera.refraction import FlatMedia
from taccel_lab.errors import InputError

_LEAST_DISTANCE_MM = 0.1


class PlaneModel(Protocol):
    """A map from the plane [mm] to the image [px] with ``count`` parameters."""

    @property
    def name(self) -> str: ...

    @property
    def count(self) -> int: ...

    def start(self, xy_mm: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
        """Parameters near the solution, from matched points [n, 2]."""
        ...

    def project(self, theta: np.ndarray, xy_mm: np.ndarray) -> np.ndarray:
        """Pixels of points on the plane, [n, 2] -> [n, 2]."""
        ...

    def prior(self, theta: np.ndarray) -> np.ndarray:
        """What is known of the parameters already, as standardised residuals [m]."""
        ...


@dataclass(frozen=True)
class BentHomography:
    """Homography, then ``p' = c + (p - c)(1 + k1 r^2 + k2 r^4)`` about a free middle c.

    Image coordinates are counted from the image's middle in half diagonals, so that k is the
    displacement of a corner as a share of its distance.
    """

    size_px: tuple[int, int]
    unit_mm: float
    """Length that the plane's coordinates are divided by, for conditioning."""
    bent: bool
    """Without, k1 and k2 are 0."""

    @property
    def name(self) -> str:
        return "homography" + " + 2 radial about a free middle" * self.bent

    @property
    def count(self) -> int:
        return 12 if self.bent else 8

    @property
    def _middle_px(self) -> np.ndarray:
        return (np.array(self.size_px, dtype=np.float64) - 1) / 2

    @property
    def _half_diagonal_px(self) -> float:
        return float(np.hypot(*self.size_px)) / 2

    def start(self, xy_mm: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
        image = (uv_px - self._middle_px) / self._half_diagonal_px
        matrix, _ = cv2.findHomography(xy_mm / self.unit_mm, image, cv2.LMEDS)
        if matrix is None:
            raise InputError("the board's points lie on a line; they do not give a homography")
        theta = np.zeros(self.count)
        theta[:8] = (np.asarray(matrix) / matrix[2, 2]).ravel()[:8]
        return theta

    def project(self, theta: np.ndarray, xy_mm: np.ndarray) -> np.ndarray:
        matrix = np.append(theta[:8], 1.0).reshape(3, 3)
        plane = np.column_stack([np.asarray(xy_mm) / self.unit_mm, np.ones(len(xy_mm))])
        image = plane @ matrix.T
        image = image[:, :2] / image[:, 2:]
        if self.bent:
            k1, k2, *middle = theta[8:]
            away = image - middle
            r2 = np.sum(away**2, axis=1, keepdims=True)
            image = middle + away * (1 + k1 * r2 + k2 * r2**2)
        return image * self._half_diagonal_px + self._middle_px

    def prior(self, theta: np.ndarray) -> np.ndarray:
        # Keeps a free middle inside the image where nothing else does: it is at the middle to
        # within a quarter of the half diagonal.
        return theta[10:] / 0.25


@dataclass(frozen=True)
class CameraPose:
    """Pose of a camera whose lens is known to within a covariance, in air or through media.

    Parameters: rotation vector and translation of camera_from_plane, then the lens's own, which
    the board may correct as far as their covariance allows.
    """

    lens: Lens
    parameters: np.ndarray
    covariance: np.ndarray
    size_px: tuple[int, int]
    media: FlatMedia | None = None
    """Flat media in front of the plane z = 0; None: nothing bends the sight lines."""

    @property
    def name(self) -> str:
        return "camera pose" if self.media is None else "camera pose with refraction"

    @property
    def count(self) -> int:
        return 6 + self.lens.parameter_count

    def start(self, xy_mm: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
        found = planar_poses(self.lens, self.parameters, self.size_px, xy_mm, uv_px)
        if not found:
            raise InputError(f"no pose of the plane explains its {len(xy_mm)} points")
        poses = [np.concatenate([pose, self.parameters]) for pose in found]
        missed = [self._project_in_air(pose, xy_mm) - uv_px for pose in poses]
        # A point that a pose puts beyond the lens's field is missed by the whole image.
        costs = [np.abs(np.nan_to_num(miss, nan=max(self.size_px))).sum() for miss in missed]
        return poses[int(np.argmin(costs))]

    def project(self, theta: np.ndarray, xy_mm: np.ndarray) -> np.ndarray:
        if self.media is None:
            return self._project_in_air(theta, xy_mm)
        seen = self._seen(theta, xy_mm)
        if seen is None:
            return np.full((len(xy_mm), 2), np.nan)  # The search stepped behind the gel.
        return self.lens.project(seen, theta[6:], np.zeros(6))

    def _seen(self, theta: np.ndarray, xy_mm: np.ndarray) -> np.ndarray | None:
        """Directions [n, 3] in the camera's frame in which points are seen through the media; None
        from behind the gel."""
        assert self.media is not None
        rotation = cv2.Rodrigues(theta[:3])[0]
        position = -rotation.T @ theta[3:6]
        if position[2] > -_LEAST_DISTANCE_MM:
            return None
        # Looking out of the camera, the plane is at z = 0 and the media lie before it.
        beyond = [i for i, z in enumerate(self.media.planes_mm) if z > position[2]]
        media = FlatMedia(
            tuple(self.media.planes_mm[i] for i in beyond),
            self.media.indices[len(self.media.planes_mm) - len(beyond) :],
        )
        points = np.column_stack([xy_mm, np.zeros(len(xy_mm))])
        return media.sight(position, points) @ rotation.T

    def _project_in_air(self, theta: np.ndarray, xy_mm: np.ndarray) -> np.ndarray:
        points = np.column_stack([xy_mm, np.zeros(len(xy_mm))])
        return self.lens.project(points, theta[6:], theta[:6])

    def prior(self, theta: np.ndarray) -> np.ndarray:
        off = theta[6:] - self.parameters
        floor = 1e-8 * np.maximum(np.abs(self.parameters), 1e-3)
        sigma = np.maximum(np.sqrt(np.diag(self.covariance)), floor)
        correlation = self.covariance / np.outer(sigma, sigma)
        correlation[np.diag_indices(len(sigma))] = 1.0
        values, vectors = np.linalg.eigh(correlation)
        return (vectors.T @ (off / sigma)) / np.sqrt(np.maximum(values, 1e-8))
