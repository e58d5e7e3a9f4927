# SPDX-License-Identifier: Apache-2.0
"""How the gel's face appears in the image, fitted to a board that lies on it: by the pose of a
camera, in air or through the flat media in front of the gel.

The camera's lens is known as well as views of a board tell it, or hardly at all: a plane that never
tilts does not tell the focal length from the distance. Whatever both are, its picture is the same,
which is all that scale and rectification need. A homography would have as many parameters, but fit
pixels that are no rectangles, too.

The model is chosen like the lens: each is fitted to four fifths of the points, and the simplest
whose error on the rest is within one standard error of the best is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
from scipy.optimize import root

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.lens import Lens, excess_over_best, planar_pose
from taccel_lab.camera.refraction import FlatMedia
from taccel_lab.errors import InputError
from taccel_lab.robust_fit import fit_robustly, rms

_FOLDS = 5
_EXACT_PX = 1e-7
_CROSS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Steps to the right, left, down and up."""
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
        points = np.column_stack([xy_mm, np.zeros(len(xy_mm))])
        if self.media is None:
            return self.lens.project(points, theta[6:], theta[:6])
        rotation = cv2.Rodrigues(theta[:3])[0]
        position = -rotation.T @ theta[3:6]
        if position[2] > -_LEAST_DISTANCE_MM:
            return np.full((len(xy_mm), 2), np.nan)  # The search stepped behind the gel.
        # Looking out of the camera, the plane is at z = 0 and the media lie before it.
        beyond = [i for i, z in enumerate(self.media.planes_mm) if z > position[2]]
        media = FlatMedia(
            tuple(self.media.planes_mm[i] for i in beyond),
            self.media.indices[len(self.media.planes_mm) - len(beyond) :],
        )
        seen = media.sight(position, points) @ rotation.T
        return self.lens.project(seen, theta[6:], np.zeros(6))

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


@dataclass(frozen=True)
class PlaneFit:
    """A model of the plane, fitted; board coordinates are those of the first view."""

    model: CameraPose
    theta: np.ndarray
    covariance: np.ndarray
    motions: np.ndarray
    """Angle [rad] and shift [mm] of each view's board on the plane, shape [view, 3]."""
    residuals: tuple[np.ndarray, ...]
    """Seen minus fitted [px] of each view, [n, 2]."""
    heldout_px: float = np.nan
    point_mse: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Held-out square error of each point, shape [all points]."""

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the points."""
        return rms(np.concatenate(self.residuals))

    def project(self, xy_mm: np.ndarray, theta: np.ndarray | None = None) -> np.ndarray:
        """Pixels of points in the first board's coordinates, [n, 2] -> [n, 2]."""
        return self.model.project(self.theta if theta is None else theta, np.asarray(xy_mm))

    def plane_points(self, views: Sequence[BoardView]) -> np.ndarray:
        """Points of all views on the plane [mm], shape [all points, 2]."""
        return np.concatenate([
            _moved(view.board_mm()[:, :2], motion)
            for view, motion in zip(views, self.motions, strict=True)
        ])  # fmt: skip

    def locate(self, uv_px: np.ndarray, theta: np.ndarray | None = None) -> np.ndarray:
        """Point of the plane [2] that is seen at a pixel [2].

        Raises:
            InputError: The model does not reach that pixel.
        """
        found = root(lambda xy: self.project(xy[None], theta)[0] - uv_px, np.zeros(2), tol=1e-13)
        if not np.linalg.norm(found.fun) <= 1e-6:
            raise InputError(f"the fitted plane is not seen at pixel {tuple(uv_px)}")
        return found.x

    def jacobian(
        self, xy_mm: np.ndarray, theta: np.ndarray | None = None, half_mm: float = 1e-4
    ) -> np.ndarray:
        """Change of the pixel along x and y [px/mm], over ``half_mm`` to both sides, [2, 2]."""
        uv = self.project(np.asarray(xy_mm) + half_mm * _CROSS, theta)
        return np.column_stack([uv[0] - uv[1], uv[2] - uv[3]]) / (2 * half_mm)


def fit_planes(views: Sequence[BoardView], models: Sequence[CameraPose]) -> list[PlaneFit]:
    """Fit every model and cross-validate it; models that the points cannot determine are left out.

    Raises:
        InputError: No model could be fitted.
    """
    fits = []
    points = sum(len(view.index) for view in views)
    for model in models:
        if 2 * points < model.determined + 3 * (len(views) - 1) + 8:
            continue
        fits.append(_with_heldout(views, fit_plane(views, model)))
    if not fits:
        raise InputError(f"{points} points of the board are too few to fit the plane of the gel")
    return fits


def choose_plane(fits: Sequence[PlaneFit]) -> tuple[PlaneFit, list[PlaneFit]]:
    """The simplest fit within one standard error of the best, and all that are within it."""
    excess, errors = excess_over_best(np.stack([fit.point_mse for fit in fits]))
    near = excess <= np.maximum(errors, _EXACT_PX**2)
    chosen = [fit for fit, one in zip(fits, near, strict=True) if one]
    return chosen[0], chosen


def _moved(xy_mm: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Points [n, 2] of a board on the plane, by its angle [rad] and shift [mm]."""
    return xy_mm @ plane_rotation(float(motion[0])).T + motion[1:]


def plane_rotation(angle_rad: float) -> np.ndarray:
    """Rotation in the plane, shape [2, 2]."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def fit_plane(
    views: Sequence[BoardView],
    model: CameraPose,
    used: Sequence[np.ndarray] | None = None,
    whole: PlaneFit | None = None,
) -> PlaneFit:
    """Robust least squares of one model, not cross-validated.

    Args:
        views: Boards on the plane.
        model: How a plane appears in the image.
        used: Which points of each view are fitted, bool; all when None.
        whole: A fit to all points, to start from when some are left out.
    """
    boards = [view.board_mm()[:, :2] for view in views]
    if used is None:
        used = [np.ones(len(view.index), dtype=bool) for view in views]
    if whole is None:
        theta = model.start(boards[0][used[0]], views[0].uv_px[used[0]])
        start = np.concatenate([theta, _first_motions(views, boards)[1:].ravel()])
    else:
        start = np.concatenate([whole.theta, whole.motions[1:].ravel()])
    count = model.count

    def residuals(x: np.ndarray) -> list[np.ndarray]:
        return [
            view.uv_px - model.project(x[:count], _moved(board, motion))
            for view, board, motion in zip(views, boards, _motions(x[count:]), strict=True)
        ]

    fitted = fit_robustly(
        lambda x: np.concatenate([r[m] for r, m in zip(residuals(x), used, strict=True)]),
        start,
        prior=lambda x: model.prior(x[:count]),
    )
    x = fitted.x
    covariance = fitted.covariance()[:count, :count] if whole is None else whole.covariance
    return PlaneFit(model, x[:count], covariance, _motions(x[count:]), tuple(residuals(x)))


def _motions(free: np.ndarray) -> np.ndarray:
    """Angle and shift of each board against the first, whose own is none, shape [view, 3]."""
    return np.vstack([np.zeros(3), free.reshape(-1, 3)])


def _first_motions(views: Sequence[BoardView], boards: list[np.ndarray]) -> np.ndarray:
    """Angle and shift of each board against the first, from similarity fits to the image."""
    pixels = [_similarity(board, view.uv_px) for view, board in zip(views, boards, strict=True)]
    (a0, t0), motions = pixels[0], []
    for a, t in pixels:
        relative = a / a0
        shift = (t - t0) / a0
        motions.append([np.angle(relative), shift.real, shift.imag])
    return np.array(motions)


def _similarity(xy: np.ndarray, uv: np.ndarray) -> tuple[complex, complex]:
    """uv = a xy + t in complex numbers."""
    z, w = xy[:, 0] + 1j * xy[:, 1], uv[:, 0] + 1j * uv[:, 1]
    solution, *_ = np.linalg.lstsq(np.column_stack([z, np.ones(len(z))]), w, rcond=None)
    return complex(solution[0]), complex(solution[1])


def _with_heldout(views: Sequence[BoardView], fit: PlaneFit) -> PlaneFit:
    """Cross-validate over the points, in parts by (column + 2 row) modulo 5."""
    folds = [(view.index[:, 0] + 2 * view.index[:, 1]) % _FOLDS for view in views]
    squares = [np.zeros(len(view.index)) for view in views]
    for k in range(_FOLDS):
        held = fit_plane(views, fit.model, [fold != k for fold in folds], fit)
        for square, residual, fold in zip(squares, held.residuals, folds, strict=True):
            square[fold == k] = np.sum(residual[fold == k] ** 2, axis=1)
    every = np.concatenate(squares)
    return replace(fit, heldout_px=float(np.sqrt(every.mean())), point_mse=every)
