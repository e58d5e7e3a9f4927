# SPDX-License-Identifier: Apache-2.0
"""Least squares of many dots on their pixels: weights, cost, normal equations, covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.dots import soft_ellipse as model

_HUBER = 2.0
_OFF = 0.04
"""Share of a dot's step in level by which pixels may always be off: the model is no better."""
_LEVEL_SIGMA = 0.6
"""And standard deviation in levels that is always granted: rounding, and a little noise."""
_PRIOR_BLUR = 1.0
"""Standard deviation of the logarithm of the blur about its guess."""
_PRIOR_ROUND = 0.5
"""Standard deviation of the relative shape about its guess."""
_MIN_BLUR_PX, _MAX_BLUR = 0.25, 1.5
"""Blur's least value [px], and its largest as a share of the radius."""


@dataclass(frozen=True)
class DotProblem:
    """Pixels of dots and what is believed of them before the fit."""

    uv: np.ndarray
    """Pixels of every window, shape [pixel, 2]."""
    levels: np.ndarray
    """Shape [dot, pixel]."""
    own: np.ndarray
    """Pixels that count, bool, shape [dot, pixel]."""
    guess: np.ndarray
    """Parameters before the fit, shape [dot, 10]."""
    scale: np.ndarray
    """Level by which a pixel may be off, shape [dot]."""
    free: np.ndarray
    """Parameters that are fitted, bool, shape [10]."""

    @classmethod
    def of(
        cls,
        uv: np.ndarray,
        levels: np.ndarray,
        own: np.ndarray,
        guess: np.ndarray,
        free_shape: bool,
    ) -> DotProblem:
        """The problem about a guess; without ``free_shape`` ellipse and blur stay."""
        free = np.ones(model.PARAMETERS, dtype=bool)
        free[[model.S11, model.S12, model.S22, model.LOG_BLUR]] = free_shape
        step = np.abs(guess[:, model.CONTRAST] * guess[:, model.LEVEL])
        return cls(uv, levels, own, guess.copy(), np.maximum(_LEVEL_SIGMA, _OFF * step), free)

    def select(self, which: np.ndarray) -> DotProblem:
        """The problem of some of the dots."""
        return DotProblem(
            self.uv,
            self.levels[which],
            self.own[which],
            self.guess[which],
            self.scale[which],
            self.free,
        )

    def bounded(self, p: np.ndarray) -> np.ndarray:
        """Parameters kept where an ellipse and a blur mean something."""
        radius = model.mean_radius(self.guess)
        p = p.copy()
        p[:, model.LOG_BLUR] = np.clip(
            p[:, model.LOG_BLUR], np.log(_MIN_BLUR_PX), np.log(np.maximum(_MAX_BLUR * radius, 0.5))
        )
        low, high = 1.0 / (3.0 * radius), 1.0 / np.maximum(0.3 * radius, 0.5)
        for k in (model.S11, model.S22):
            p[:, k] = np.clip(p[:, k], low, high)
        most = 0.9 * np.sqrt(p[:, model.S11] * p[:, model.S22])
        p[:, model.S12] = np.clip(p[:, model.S12], -most, most)
        return p

    def weights(self, value: np.ndarray) -> np.ndarray:
        """Huber's weights about a robust scale that is never below ``scale``; 0 outside."""
        miss = np.abs(self.levels - value)
        ordered = np.sort(np.where(self.own, miss, np.inf), axis=1)
        middle = self.own.sum(axis=1) // 2
        spread = ordered[np.arange(len(ordered)), middle] / 0.6745
        spread = np.where(np.isfinite(spread), spread, 0.0)
        bound = _HUBER * np.maximum(spread, self.scale)[:, None]
        return np.where(self.own, np.minimum(1.0, bound / np.maximum(miss, 1e-12)), 0.0)

    def cost(self, value: np.ndarray, weight: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Weighted squares plus what the beliefs cost, shape [dot]."""
        belief = self._beliefs() * (self.guess - p) ** 2
        squares = (weight * (self.levels - value) ** 2).sum(axis=1)
        return squares + belief[:, self.free].sum(axis=1)

    def normal_equations(
        self, value: np.ndarray, weight: np.ndarray, jacobian: np.ndarray, p: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and right side of the step, shapes [dot, 10, 10] and [dot, 10]."""
        weighted = (jacobian * weight[..., None]).transpose(0, 2, 1)
        normal = np.matmul(weighted, jacobian)
        gradient = np.matmul(weighted, (self.levels - value)[..., None])[..., 0]
        belief = self._beliefs()
        np.einsum("nii->ni", normal)[:] += belief
        gradient = gradient + belief * (self.guess - p)
        fixed = np.flatnonzero(~self.free)
        normal[:, fixed, :] = 0.0
        normal[:, :, fixed] = 0.0
        normal[:, fixed, fixed] = 1.0
        gradient[:, fixed] = 0.0
        return normal, gradient

    def uncertainty(self, p: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
        """Covariance of the centres from the scatter that the fit left, and that scatter.

        Args:
            p: Fitted parameters.
            side: Pixels along one side of the window.

        Returns:
            Covariance [px^2], shape [dot, 2, 2], infinite where too few pixels count; standard
            deviation of the pixels [levels], shape [dot].
        """
        value, jacobian = model.evaluate(p, self.uv)
        weight = self.weights(value)
        normal, _ = self.normal_equations(value, weight, jacobian, p)
        total, fitted = weight.sum(axis=1), int(self.free.sum())
        miss = self.levels - value
        variance = (weight * miss**2).sum(axis=1) / np.maximum(total - fitted, 1.0)
        variance = variance * _neighbours_alike(miss, weight, side)
        good = (total > 1.5 * fitted) & np.isfinite(normal).all(axis=(1, 2))
        safe = np.where(good[:, None, None], normal, np.eye(model.PARAMETERS))
        known = np.linalg.pinv(safe)[:, :2, :2] * variance[:, None, None]
        good &= np.einsum("nii->ni", known).min(axis=1) > 0
        covariance = np.where(good[:, None, None], known, np.diag([np.inf, np.inf]))
        return covariance, np.sqrt(variance)

    def _beliefs(self) -> np.ndarray:
        """Weights of the weak beliefs about blur and shape, shape [dot, 10]."""
        weight = np.zeros_like(self.guess)
        weight[:, model.LOG_BLUR] = (self.scale / _PRIOR_BLUR) ** 2
        shape = (self.scale * model.mean_radius(self.guess) / _PRIOR_ROUND) ** 2
        weight[:, model.SHAPE] = shape[:, None]
        return weight


def _neighbours_alike(residual: np.ndarray, weight: np.ndarray, side: int) -> np.ndarray:
    """Factor on the variance for residuals that neighbours share (blur, compression), >= 1.

    White noise that went through a Gaussian of width s has the correlation exp(-d^2 / 4 s^2) at
    distance d, whose sum is sqrt(4 pi) s along each direction: sqrt(pi / -ln rho) from neighbours'
    correlation rho.
    """
    grid = np.where(weight > 0, residual, 0.0).reshape(len(residual), side, side)
    seen = (weight > 0).reshape(grid.shape)
    power = (grid**2).sum(axis=(1, 2)) / np.maximum(seen.sum(axis=(1, 2)), 1)
    factor = np.ones(len(residual))
    for a, b, m, n in (
        (grid[:, 1:], grid[:, :-1], seen[:, 1:], seen[:, :-1]),
        (grid[:, :, 1:], grid[:, :, :-1], seen[:, :, 1:], seen[:, :, :-1]),
    ):
        both = (a * b).sum(axis=(1, 2)) / np.maximum((m & n).sum(axis=(1, 2)), 1)
        rho = np.clip(both / np.maximum(power, 1e-12), 1e-3, 0.9)
        factor *= np.maximum(np.sqrt(np.pi / -np.log(rho)), 1.0)
    return factor
