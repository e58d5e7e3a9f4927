# SPDX-License-Identifier: Apache-2.0
"""Robust least squares of points in the image, whose error is a length and not two numbers.

``scipy.optimize.least_squares`` minimises with Huber's loss (P. J. Huber, "Robust Statistics",
1981) of the length of each point's residual. Its own ``loss`` takes u and v by themselves, so that
what counts as far off would depend on how the image is turned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from taccel_lab.calibration.robust_spread import spread_of_lengths

HUBER = 2.0
"""Length of a residual over the standard deviation along an axis from which on it counts less: 98 %
efficiency on normal noise in two dimensions."""
_EXACT_PX = 1e-9
"""Scale of residuals below which they are taken for exact."""
_MOST_STEPS = 200
_ROUNDS, _STEADY = 20, 1e-3
"""Fits with a new scale at most, and the relative change of the scale that asks for no other."""


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
    """Of what was minimised: roots of the losses, u and v of each point, then the prior."""


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
    jacobian: Callable[[np.ndarray], np.ndarray],
    prior: Callable[[np.ndarray], np.ndarray] | None = None,
    robust: bool = True,
    tolerance: float = 1e-12,
) -> RobustFit:
    """Parameters that make the sum of Huber's losses least; its scale is that of the residuals.

    Args:
        residuals: Of the points [px] by parameters, [k] -> [n, 2]; a step to where one is not
            finite is not taken.
        start: Parameters to start from, shape [k].
        jacobian: Their derivatives, [k] -> [n, 2, k].
        prior: What is known of the parameters already, as standardised residuals, [k] -> [m],
            linear in them.
        robust: Huber's loss, or plain squares.
        tolerance: Of cost, step and gradient.
    """

    none = np.zeros_like(np.asarray(start, dtype=np.float64))
    known = [] if prior is None else [
        prior(one) - prior(none) for one in np.eye(len(none))
    ]  # fmt: skip

    def at_scale(x: np.ndarray, scale: float) -> OptimizeResult:
        limit = HUBER * scale if robust else np.inf

        def to_minimise(x: np.ndarray) -> np.ndarray:
            points = _root_loss(residuals(x), limit)[0].ravel()
            return points if prior is None else np.append(points, scale * prior(x))

        def slopes(x: np.ndarray) -> np.ndarray:
            left, by_x = residuals(x), jacobian(x)
            _, share, bend = _root_loss(left, limit)
            along = np.einsum("nk,nkj->nj", left, by_x)
            turned = share[:, None, None] * by_x
            turned += (bend[:, None] * left)[..., None] * along[:, None]
            points = turned.reshape(-1, len(x))
            return np.vstack([points, scale * np.transpose(known)]) if known else points

        return least_squares(
            to_minimise,
            x,
            jac=slopes,  # type: ignore[arg-type]
            x_scale="jac",
            xtol=tolerance,
            ftol=tolerance,
            gtol=tolerance,
            max_nfev=_MOST_STEPS,
        )

    x = np.array(start, dtype=np.float64)
    scale = _scale(residuals(x))
    fitted = at_scale(x, scale)
    for _ in range(_ROUNDS if robust else 0):
        before, scale = scale, _scale(residuals(fitted.x))
        if abs(scale - before) <= _STEADY * before:
            break
        fitted = at_scale(fitted.x, scale)
    left = residuals(fitted.x)
    weights = huber_weights(left) if robust else np.ones(len(left))
    return RobustFit(fitted.x, left, weights, fitted.jac)


def _scale(left: np.ndarray) -> float:
    return max(robust_scale(left), _EXACT_PX)


def _root_loss(left: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vectors [n, 2] whose squares are Huber's losses of ``left``; the share of each that they
    keep, shape [n]; and the derivative of that share by half the squared length, shape [n]."""
    length = np.linalg.norm(left, axis=1)
    share, bend = np.ones(len(left)), np.zeros(len(left))
    far = length > limit
    beyond = length[far]
    root = np.sqrt(2 * limit * beyond - limit**2)
    share[far] = root / beyond
    bend[far] = (limit / root - share[far]) / beyond**2
    return share[:, None] * left, share, bend
