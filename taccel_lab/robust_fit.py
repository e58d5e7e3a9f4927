# SPDX-License-Identifier: Apache-2.0
"""Robust statistics and least squares: spreads that strangers among values do not move, the damped
search of all fits here, and points in a plane, whose error is a length and not two numbers.

P. J. Rousseeuw and C. Croux, "Alternatives to the median absolute deviation", 1993: the median of
absolute deviations of normal noise is 0.6745 standard deviations.

Gauss-Newton steps are damped after Levenberg 1944 and Marquardt 1963, within bounds. They are
measured in what each parameter does to the function, so that no scales are asked for.

Huber's loss (P. J. Huber, "Robust Statistics", 1981) of the length of each point's residual. The
``loss`` of ``scipy.optimize.least_squares`` takes u and v by themselves, so that what counts as far
off would depend on how the image is turned.

How wide a radius must be to hold a share of the errors of presses that were not seen is found on
presses as cross-conformal prediction finds it (V. Vovk, Cross-conformal predictors, Ann. Math.
Artif. Intell. 74, 2015; R. F. Barber et al., Predictive inference with the jackknife+, Ann. Stat.
49, 2021). Errors of the inverse model are not normal: a radius of 2.45 standard deviations holds 90
to 93 % of them on real presses, not 95 %.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, issparse

_MEDIAN_LENGTHS = {1: 0.6744897501960817, 2: 1.1774, 3: 1.538}
"""Median length of a vector of this number of standard normal variables."""
_STEPS = 100
_RESTING = 1e-9
"""Step of a parameter, over its curvature's standard deviation, below which a refused step ends
it."""
Expanded = tuple[float, np.ndarray, np.ndarray]
Expansion = Callable[[np.ndarray, float], Expanded]
"""A function of parameters [k]: its value (infinite where it has none), its gradient [k] and, as
Gauss and Newton have it, its curvature [k, k]. The derivatives are asked for where the value lies
below the second argument."""
HUBER = 2.0
"""Length of a residual over the standard deviation along an axis from which on it counts less: 98 %
efficiency on normal noise in two dimensions."""
_EXACT = 1e-9
"""Scale of residuals below which they are taken for exact."""
_ROUNDS, _STEADY = 30, 1e-3
"""Fits at new scales at most, and the change of the scale, relative, that asks for no other."""
_GAIN = 1e-11
"""Gain of the loss by a step, relative, below which a search is over."""
_STEP = 6e-6
"""Relative step of differences: the cube root of the rounding error."""
Residuals = Callable[[np.ndarray], np.ndarray]
"""Residuals of the points by parameters, [k] -> [n, 2]; not finite where there is none."""
Matrix = np.ndarray | csr_array
Jacobian = Callable[[np.ndarray], Matrix]
"""Derivatives of all u and v, point by point, [k] -> [2 n, k]; sparse where most are zero."""
HIGHEST_LEVEL = 0.995
LEVELS = 46
MIN_PRESSES = 4
"""Fewest presses: with fewer, nothing is known of how presses differ."""


def spread_about_median(values: np.ndarray) -> float:
    """Standard deviation of normal noise about the values' median, of all values together."""
    return spread_about_zero(np.asarray(values) - np.median(values))


def spread_about_zero(values: np.ndarray) -> float:
    """Standard deviation of normal noise about zero, such as residuals have."""
    return spread_of_lengths(np.abs(values), 1)


def spread_of_lengths(lengths: np.ndarray, dimensions: int) -> float:
    """Standard deviation along an axis of normal vectors of 1 to 3 dimensions, by their lengths."""
    return float(np.median(lengths)) / _MEDIAN_LENGTHS[dimensions]


def damped_search(
    expand: Expansion,
    start: np.ndarray,
    *,
    low: np.ndarray | float = -np.inf,
    high: np.ndarray | float = np.inf,
    moving: np.ndarray | None = None,
    least_gain: float = 0.0,
    relative_gain: float = 0.0,
) -> tuple[np.ndarray, float, bool]:
    """Parameters [k] of the least value, that value, and whether the search came to an end.

    Args:
        expand: The function.
        start: Parameters to start from, shape [k], where it is finite.
        low: Bounds of the parameters, shape [k].
        high: See ``low``.
        moving: Parameters that are not held, bool, shape [k]; all when left out.
        least_gain: A step that gains no more is the last.
        relative_gain: Likewise, as a part of the value.
    """
    theta = np.clip(np.array(start, dtype=np.float64), low, high)
    moves = np.ones(len(theta), dtype=bool) if moving is None else moving
    value, gradient, curvature = expand(theta, np.inf)
    damping = 1e-4
    for _ in range(_STEPS):
        outward = ((theta <= low) & (gradient > 0)) | ((theta >= high) & (gradient < 0))
        free = np.flatnonzero(moves & ~outward)
        if not len(free):
            return theta, value, True
        diagonal = np.diag(curvature)[free]
        # A parameter without influence has no curvature.
        scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-12 * diagonal.max() + 1e-300))
        scaled = curvature[np.ix_(free, free)] * np.outer(scale, scale)
        scaled[np.diag_indices(len(free))] += damping
        trial = theta.copy()
        trial[free] -= scale * np.linalg.solve(scaled, scale * gradient[free])
        trial = np.clip(trial, low, high)
        there = expand(trial, value)
        if there[0] < value:
            gain = value - there[0]
            theta, (value, gradient, curvature) = trial, there
            damping = max(0.1 * damping, 1e-13)
            if gain <= least_gain + relative_gain * abs(value):
                return theta, value, True
        elif (np.abs(trial - theta)[free] <= _RESTING * scale).all():
            return theta, value, True
        else:
            damping = max(10 * damping, 1e-3)
    return theta, value, False


@dataclass(frozen=True)
class RobustFit:
    """What a fit found."""

    x: np.ndarray
    """Parameters, shape [k]."""
    residuals: np.ndarray
    """Residuals of the points, shape [n, 2]."""
    weights: np.ndarray
    """Huber's weights of the points, shape [n]."""
    jacobian: Matrix
    """Derivatives of all u and v, shape [2 n, k]."""
    prior: np.ndarray
    """Derivatives of the standardised prior, shape [m, k]."""
    converged: bool

    def covariance(self, groups: tuple[np.ndarray, ...] = ()) -> np.ndarray:
        """Covariance of the parameters, shape [k, k], by the scatter that is left.

        Args:
            groups: Names of the points, each of shape [n], whose errors may go together (a bent
                board, a common blur): where the sandwich estimate by such groups is wider, it sets
                the standard deviations.
        """
        freedom = max(self.residuals.size - len(self.x), 1)
        variance = float(self.weights @ (self.residuals**2).sum(axis=1)) / freedom
        information = _information(self.jacobian, self.weights) + variance * (
            self.prior.T @ self.prior
        )
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        inverse = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-14)
        inverse *= np.outer(scale, scale)
        plain = np.sqrt(np.maximum(variance * np.diag(inverse), 0.0))
        wider = np.ones(len(self.x))
        pull = self.weights[:, None] * self.residuals
        for group in groups:
            names, which = np.unique(group, return_inverse=True)
            member = csr_array((pull.ravel(), (np.repeat(which, 2), np.arange(pull.size))))
            shifts = _dense(member @ self.jacobian) @ inverse
            meat = (shifts**2).sum(axis=0) * len(names) / max(len(names) - 1, 1)
            ratio = np.divide(np.sqrt(meat), plain, out=np.ones_like(plain), where=plain > 1e-100)
            wider = np.maximum(wider, ratio)
        return variance * inverse * np.outer(wider, wider)


def robust_scale(residual: np.ndarray) -> float:
    """Standard deviation along an axis of vectors [n, 2], by their median length."""
    return spread_of_lengths(np.linalg.norm(residual, axis=1), 2)


def huber_weights(residual: np.ndarray, scale: float) -> np.ndarray:
    """Weight of each vector [n, 2] by its length: 1 up to ``HUBER`` scales, falling off beyond.

    ``scale`` is the standard deviation along an axis.
    """
    length = np.linalg.norm(residual, axis=1)
    limit = HUBER * max(scale, _EXACT)
    return np.where(length <= limit, 1.0, limit / np.maximum(length, 1e-300))


def rms(residuals: np.ndarray) -> float:
    """Root mean square length of vectors [n, 2]."""
    return float(np.sqrt(np.mean(np.sum(np.square(residuals), axis=-1))))


def _dense(matrix: Matrix) -> np.ndarray:
    return csr_array(matrix).toarray() if issparse(matrix) else np.asarray(matrix)


def _information(jacobian: Matrix, weights: np.ndarray) -> np.ndarray:
    """J^T W J of the weights of points, shape [k, k]."""
    return _dense(jacobian.T @ (jacobian * np.repeat(weights, 2)[:, None]))


def slopes(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Derivatives of a function's values, flat, by differences, shape [value, k]."""
    columns = []
    for k, step in enumerate(_STEP * np.maximum(np.abs(x), 1e-3)):
        up, down = x.copy(), x.copy()
        up[k], down[k] = x[k] + step, x[k] - step
        columns.append(((function(up) - function(down)) / (up[k] - down[k])).ravel())
    return np.stack(columns, axis=1)


def fit_robustly(
    residuals: Residuals,
    start: np.ndarray,
    *,
    jacobian: Jacobian | None = None,
    prior: Callable[[np.ndarray], np.ndarray] | None = None,
    robust: bool = True,
) -> RobustFit:
    """Parameters that make the sum of Huber's losses least; its scale is that of the residuals.

    Args:
        residuals: Of the points; a step to where one is not finite is not taken.
        start: Parameters to start from, shape [k].
        jacobian: Their derivatives; by differences when left out.
        prior: What is known of the parameters already, as standardised residuals, [k] -> [m].
        robust: Huber's loss, or plain squares.
    """

    def of_points(x: np.ndarray) -> Matrix:
        return slopes(residuals, x) if jacobian is None else jacobian(x)

    def of_prior(x: np.ndarray) -> np.ndarray:
        return np.zeros((0, len(x))) if prior is None else slopes(prior, x)

    def weigh(left: np.ndarray, scale: float) -> np.ndarray:
        return huber_weights(left, scale) if robust else np.ones(len(left))

    def searched(x: np.ndarray, scale: float, gain: float) -> tuple[np.ndarray, float, bool]:
        def expand(x: np.ndarray, below: float) -> Expanded:
            left = residuals(x)
            known = np.zeros(0) if prior is None else scale * prior(x)
            weights = weigh(left, scale)
            # Huber's loss: squares, beyond the limit twice the length times it, less its square.
            loss = float((left**2).sum(axis=1) @ (weights * (2 - weights)) + known @ known)
            if not loss < below:
                return np.inf, np.zeros(0), np.zeros((0, 0))
            by_x, by_known = of_points(x), scale * of_prior(x)
            gradient = by_x.T @ (weights[:, None] * left).ravel() + by_known.T @ known
            return loss, gradient, _information(by_x, weights) + by_known.T @ by_known

        return damped_search(expand, x, relative_gain=gain)

    x = np.array(start, dtype=np.float64)
    scale = max(robust_scale(residuals(x)), _EXACT)
    for _ in range(_ROUNDS):
        x, *_ = searched(x, scale, _STEADY)
        before, scale = scale, max(robust_scale(residuals(x)), _EXACT)
        if abs(scale - before) <= _STEADY * scale:
            break
    x, _, converged = searched(x, scale, _GAIN)
    left = residuals(x)
    return RobustFit(x, left, weigh(left, scale), of_points(x), of_prior(x), converged)


def radius_factor(scores: Sequence[np.ndarray], share: float, otherwise: float) -> float:
    """Factor on the expected error that holds ``share`` of the errors of a new press.

    It is the error of the member that left a press out, over what the finished ensemble expects
    there. A single member errs more than the ensemble, which makes the radius rather too wide than
    too narrow. Pixels of one press err together, so presses weigh alike, and the quantile is the
    one at which presses, each judged by the others alone, have the share wanted: a few presses need
    a higher one.

    Args:
        scores: Errors over expected errors of the pixels of each left-out press, shape [n] each.
        share: Share of a press's pixels that the radius should hold.
        otherwise: The factor where too few presses tell.
    """
    presses = [np.sort(score) for score in scores if len(score)]
    if len(presses) < MIN_PRESSES:
        return otherwise
    levels = np.linspace(share, HIGHEST_LEVEL, LEVELS)
    held = np.empty((len(presses), LEVELS))
    for k, press in enumerate(presses):
        limits = _quantiles([other for i, other in enumerate(presses) if i != k], levels)
        held[k] = np.searchsorted(press, limits, side="right") / len(press)
    enough = np.flatnonzero(held.mean(axis=0) >= share - 1e-9)
    level = levels[enough[0]] if len(enough) else HIGHEST_LEVEL
    return float(_quantiles(presses, np.array([level]))[0])


def _quantiles(presses: Sequence[np.ndarray], levels: np.ndarray) -> np.ndarray:
    """Quantiles of all pixels, presses of equal weight."""
    values = np.concatenate(presses)
    weights = np.concatenate([np.full(len(press), 1.0 / len(press)) for press in presses])
    order = np.argsort(values)
    share = np.cumsum(weights[order]) / len(presses)
    at = np.searchsorted(share, levels - 1e-9)
    return values[order][np.minimum(at, len(values) - 1)]
