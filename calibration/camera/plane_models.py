# SPDX-License-Identifier: Apache-2.0
"""How the plane of the gel's face appears in the image: the pose of a camera, in air or through the
flat media in front of the gel.

The camera's lens is known as well as views of a board tell it, or hardly at all: a plane that never
tilts does not tell the focal length from the distance. Whatever both are, its picture is the same,
which is all that scale and rectification need. A homography would have as many parameters, but fit
pixels that are no rectangles, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from taccel_lab.calibration.camera.lens import Lens
from taccel_lab.calibration.camera.planar_pose import planar_pose
from taccel_lab.camera.refraction import FlatMedia

_LEAST_DISTANCE_MM = 0.1
_FOCAL, _MIDDLE, _BENT = 0.5, 0.25, 10.0
"""Standard deviations of an unknown lens: focal lengths in image widths about one, the middle in
half diagonals about the image's, which keeps it inside, and radial terms."""


@dataclass(frozen=True, eq=False)
class CameraPose:
    """Pose of a camera whose lens is known to within a covariance.

    Parameters: rotation vector and translation of camera_from_plane, then the lens's own, which
    the board may correct as far as their covariance allows.
    """

    lens: Lens
    parameters: np.ndarray
    covariance: np.ndarray
    size_px: tuple[int, int]
    media: FlatMedia | None = None
    """Flat media in front of the plane z = 0; None: nothing bends the sight lines."""
    name: str = "camera pose"
    determined: int = 6
    """How many parameters only the board can tell."""

    @classmethod
    def of_unknown(cls, size_px: tuple[int, int], bent: bool) -> CameraPose:
        """A camera of which hardly anything is known: straight, or with two radial terms about a
        free middle (``bent``)."""
        width, height = size_px
        parameters = np.array([width, width, (width - 1) / 2, (height - 1) / 2, 0.0, 0.0])
        sigma = np.array(
            [_FOCAL * width] * 2 + [_MIDDLE * np.hypot(*size_px) / 2] * 2 + [_BENT] * 2
        )
        if not bent:  # Where the middle is makes no difference.
            parameters, sigma = parameters[:4], np.append(sigma[:2], [1e-3, 1e-3])
        lens = Lens("pinhole", len(parameters) - 4, 5)
        name = "unknown lens" + ", 2 radial terms about a free middle" * bent
        return cls(lens, parameters, np.diag(sigma**2), size_px, None, name, 12 if bent else 8)

    @property
    def count(self) -> int:
        return 6 + self.lens.parameter_count

    def start(self, xy_mm: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
        """Parameters near the solution, from matched points [n, 2]."""
        pose = planar_pose(self.lens, self.parameters, self.size_px, xy_mm, uv_px)
        return np.concatenate([pose, self.parameters])

    def project(self, theta: np.ndarray, xy_mm: np.ndarray) -> np.ndarray:
        """Pixels of points on the plane [mm], [n, 2] -> [n, 2]."""
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
        """What is known of the lens already, as standardised residuals, shape [p]."""
        return self._whitening @ (theta[6:] - self.parameters)

    @cached_property
    def _whitening(self) -> np.ndarray:
        floor = 1e-8 * np.maximum(np.abs(self.parameters), 1e-3)
        sigma = np.maximum(np.sqrt(np.diag(self.covariance)), floor)
        correlation = self.covariance / np.outer(sigma, sigma)
        correlation[np.diag_indices(len(sigma))] = 1.0
        values, vectors = np.linalg.eigh(correlation)
        return (vectors / np.sqrt(np.maximum(values, 1e-8))).T / sigma
