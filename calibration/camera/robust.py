# SPDX-License-Identifier: Apache-2.0
"""Robust least squares of points in the image, whose error is a length and not two numbers.

Huber's loss (P. J. Huber, "Robust Statistics", 1981) of the length of each point's residual, by
reweighted least squares. The ``loss`` of ``scipy.optimize.least_squares`` takes u and v by
themselves, so that what counts as far off would depend on how the image is turned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import least_squares

from taccel_lab.calibration.robust_spread import spread_of_lengths

HUBER = 2.0
"""Length of a residual over the standard deviation along an axis from which on it counts less: 98 %
efficiency on normal noise in two dimensions."""
_EXACT_PX = 1e-9
"""Scale of residuals below which they are taken for exact."""
_ROUNDS, _STEADY = 30, 1e-3
"""Fits with new weights at most, and the change of any point, in scales, that asks for no other."""


@dataclass(frozen=True)
class RobustFit:
    """What a fit found."""

    x: np.ndarray
    """Parameters, shape [k]."""
    residuals: np.ndarray
    """Of the points [px], shape [n, 2]."""
    weights: np.ndarray
    """Huber's weights of the points, shape [n]."""
    jacobian: np.ndarray
    """Of what was minimised: weighted u and v of each point, then the prior over the scale."""


def robust_scale(residual: np.ndarray) -> float:
    """Standard deviation along an axis of vectors [n, 2], by their median length."""
    return spread_of_lengths(np.linalg.norm(residual, axis=1), 2)


def huber_weights(residual: np.ndarray, scale: float | None = None) -> np.ndarray:
    """Weight of each vector [n, 2] by its length: 1 up to ``HUBER`` scales, falling off beyond.

    ``scale`` is the standard deviation along an axis; that of the residuals themselves without.
    """
    length = np.linalg.norm(residual, axis=1)
    if scale is None:
        scale = robust_scale(residual)
    limit = HUBER * max(scale, _EXACT_PX)
    return np.where(length <= limit, 1.0, limit / np.maximum(length, 1e-300))


def rms(residuals: np.ndarray) -> float:
    """Root mean square length of vectors [n, 2]."""
    return float(np.sqrt(np.mean(np.sum(np.square(residuals), axis=-1))))


def fit_robustly(
    residuals: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    *,
    jacobian: Callable[[np.ndarray], np.ndarray] | Literal["2-point"] = "2-point",
    prior: Callable[[np.ndarray], np.ndarray] | None = None,
    robust: bool = True,
    tolerance: float = 1e-12,
) -> RobustFit:
    """Parameters that make the sum of Huber's losses least; its scale is that of the residuals.

    Args:
        residuals: Of the points [px] by parameters, [k] -> [n, 2]; a step to where one is not
            finite is not taken.
        start: Parameters to start from, shape [k].
        jacobian: Their derivatives, [k] -> [n, 2, k], of a fit without ``prior``; by differences
            when left out.
        prior: What is known of the parameters already, as standardised residuals, [k] -> [m].
        robust: Huber's loss, or plain squares.
        tolerance: Of cost, step and gradient.
    """
    x = np.array(start, dtype=np.float64)
    left = residuals(x)
    for _ in range(_ROUNDS if robust else 1):
        scale = max(robust_scale(left), _EXACT_PX)
        weights = huber_weights(left, scale) if robust else np.ones(len(left))
        root = np.sqrt(weights)[:, None]

        def to_minimise(x: np.ndarray, root: np.ndarray = root, scale: float = scale) -> np.ndarray:
            points = (root * residuals(x)).ravel()
            return points if prior is None else np.append(points, scale * prior(x))

        def slopes(x: np.ndarray, root: np.ndarray = root) -> np.ndarray:
            assert callable(jacobian)
            return (root[..., None] * jacobian(x)).reshape(-1, len(x))

        fitted = least_squares(
            to_minimise,
            x,
            jac=slopes if callable(jacobian) else jacobian,  # type: ignore[arg-type]
            x_scale="jac",
            xtol=tolerance,
            ftol=tolerance,
            gtol=tolerance,
        )
        x, before, left = fitted.x, left, residuals(fitted.x)
        if np.linalg.norm(left - before, axis=1).max() <= max(_STEADY * scale, _EXACT_PX):
            break
    return RobustFit(x, left, weights, fitted.jac)
