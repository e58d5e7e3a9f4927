# SPDX-License-Identifier: Apache-2.0
"""The gel frame on a fitted plane, and the scale of the image: mm/px along x and y apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.plane_fit import PlaneFit, plane_rotation
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.robust_fit import slopes


@dataclass(frozen=True)
class GelFrame:
    """Where the gel frame lies on the plane, and the scale of the image there."""

    origin_mm: np.ndarray
    """The gel frame's origin in the first board's coordinates, shape [2]."""
    angle_rad: float
    """Turn of the gel's x axis against the board's."""
    mm_per_px_x: Estimate
    mm_per_px_y: Estimate
    correlation: float
    shear: float
    """How far the image's axes are from a right angle [rad]."""

    def board_from_gel(self, xy_mm: np.ndarray) -> np.ndarray:
        """Board coordinates of gel points, [n, 2] -> [n, 2]."""
        return np.asarray(xy_mm) @ plane_rotation(self.angle_rad).T + self.origin_mm


def gel_frame(
    fit: PlaneFit,
    center_px: tuple[float, float],
    *,
    half_mm: float,
    near: Sequence[PlaneFit] = (),
) -> GelFrame:
    """Gel frame with its origin at a pixel: x to the right of the image, y down.

    Args:
        half_mm: The scale is the mean over this distance to both sides of the origin; a pitch of
            the board. In a distorted image, the scale changes over it.
        near: Other fits that explain the points as well; how their scales differ is added to the
            standard deviations.
    """
    center = np.array(center_px, dtype=np.float64)
    origin, angle, scale, shear = _scale_at(fit, center, fit.theta, half_mm)
    covariance = _model_covariance(fit, center, half_mm)
    own = np.diag(covariance).copy()
    systematic = np.zeros(2)
    for other in near:
        if other.model == fit.model:
            continue
        off = _scale_at(other, center, other.theta, half_mm)[2] - scale
        # A richer model is noisier: only what exceeds that is a difference of models (J. Hausman,
        # Econometrica 46, 1978: the variance of the difference is that of the variances).
        noise = np.diag(_model_covariance(other, center, half_mm)) - own
        systematic += np.maximum(off**2 - np.maximum(noise, 0.0), 0.0)
    covariance += np.diag(systematic / max(len(near), 1))
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    product = float(deviation[0] * deviation[1])
    return GelFrame(
        origin,
        angle,
        Estimate(float(scale[0]), float(deviation[0]), "mm/px"),
        Estimate(float(scale[1]), float(deviation[1]), "mm/px"),
        float(np.clip(covariance[0, 1] / product, -1, 1)) if product > 0 else 0.0,
        shear,
    )


def _model_covariance(fit: PlaneFit, center: np.ndarray, half_mm: float) -> np.ndarray:
    """Covariance of mm/px along x and y by that of the model's parameters, shape [2, 2]."""
    by_theta = slopes(lambda theta: _scale_at(fit, center, theta, half_mm)[2], fit.theta)
    return by_theta @ fit.covariance @ by_theta.T


def _scale_at(
    fit: PlaneFit, center: np.ndarray, theta: np.ndarray, half_mm: float
) -> tuple[np.ndarray, float, np.ndarray, float]:
    """Origin [2], angle, mm/px [2] and shear for given parameters.

    The rotation is the one that makes the derivative of the image by gel coordinates symmetric
    (polar decomposition): no turn is left between the axes of gel and image.
    """
    origin = fit.locate(center, theta)
    u, s, vt = np.linalg.svd(fit.jacobian(origin, theta, half_mm))
    stretch = u @ np.diag(s) @ u.T
    turn = (u @ vt).T
    angle = float(np.arctan2(turn[1, 0], turn[0, 0]))
    return origin, angle, 1.0 / np.diag(stretch), float(2 * stretch[0, 1] / np.trace(stretch))


def scale_range(fit: PlaneFit, views: Sequence[BoardView], half_mm: float) -> tuple[float, float]:
    """Least and largest local scale under the board, relative to the one at its middle."""
    board = fit.plane_points(views)
    local = np.array([_mean_scale(fit, xy, half_mm) for xy in board])
    at_middle = _mean_scale(fit, board.mean(axis=0), half_mm)
    return float(local.min() / at_middle), float(local.max() / at_middle)


def _mean_scale(fit: PlaneFit, xy_mm: np.ndarray, half_mm: float) -> float:
    return float(1 / np.sqrt(abs(np.linalg.det(fit.jacobian(xy_mm, half_mm=half_mm)))))
