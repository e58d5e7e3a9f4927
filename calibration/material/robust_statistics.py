# SPDX-License-Identifier: Apache-2.0
"""Linear regression that outliers do not bend, of rows in time order, and means of estimates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from taccel_lab.calibration.result import NORMAL_95, Estimate
from taccel_lab.calibration.robust_spread import spread_about_zero

MOST_CORRELATED = 0.98


@dataclass(frozen=True)
class Regression:
    """Coefficients of columns, shape [column], with their covariance."""

    values: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray
    """Target less fit, shape [row]."""
    dof: int

    def estimate(self, value: float, gradient: np.ndarray, unit: str = "") -> Estimate:
        """A value >= 0 made of the coefficients, given its derivatives by them."""
        sigma = math.sqrt(max(float(gradient @ self.covariance @ gradient), 0.0))
        half = sigma * float(student.ppf(0.975, self.dof))
        ends = max(value - half, 0.0), max(value + half, 0.0)
        return Estimate(max(value, 0.0), sigma, unit, ends)


def robust_regression(columns: np.ndarray, target: np.ndarray) -> Regression:
    """M-estimate of target = columns x, with rows in the order of time.

    The covariance is Huber's sandwich A^-1 B A^-1 (1981). Residuals in time order are not
    independent: it grows by (1 + r) / (1 - r) for a correlation r of neighbours (Bartlett 1935).
    """
    start = np.linalg.lstsq(columns, target, rcond=None)[0]
    spread = spread_about_zero(target - columns @ start)
    scale = max(spread, 1e-9 * float(np.abs(target).max()))
    found = least_squares(
        lambda x: columns @ x - target, start, loss="soft_l1", f_scale=scale, x_scale="jac"
    ).x
    residuals = target - columns @ found
    bent = 1 + (residuals / scale) ** 2
    influence = residuals / np.sqrt(bent)
    count, unknowns = columns.shape
    dof = max(count - unknowns, 1)
    outer = np.linalg.pinv(columns.T @ (columns * bent[:, None] ** -1.5))
    inner = columns.T @ (columns * influence[:, None] ** 2) * count / dof
    r = 0.0
    if count > 10 and residuals.std() > 0:
        r = float(np.corrcoef(residuals[:-1], residuals[1:])[0, 1])
        r = min(max(r, 0.0), MOST_CORRELATED)
    return Regression(found, outer @ inner @ outer * (1 + r) / (1 - r), residuals, dof)


def combined(estimates: Sequence[Estimate]) -> Estimate:
    """One value of several estimates of something >= 0, weighted; their spread counts as error.

    Random effects: the variance between estimates is what their scatter shows beyond their own
    errors (DerSimonian and Laird 1986).
    """
    if len(estimates) == 1:
        return estimates[0]
    value = np.array([item.value for item in estimates])
    variance = np.array([max(item.sigma, 1e-9) for item in estimates]) ** 2
    weight = 1 / variance
    excess = (scatter(estimates) - 1) * (len(value) - 1)
    between = max(0.0, excess / float(weight.sum() - (weight**2).sum() / weight.sum()))
    weight = 1 / (variance + between)
    mean, sigma = float(weight @ value / weight.sum()), float(weight.sum() ** -0.5)
    half = sigma * (float(student.ppf(0.975, len(value) - 1)) if between > 0 else NORMAL_95)
    return Estimate(mean, sigma, estimates[0].unit, (max(mean - half, 0.0), mean + half))


def scatter(estimates: Sequence[Estimate]) -> float:
    """Variance of estimates about their mean in their own units: about 1 where they agree."""
    value = np.array([item.value for item in estimates])
    weight = np.array([max(item.sigma, 1e-9) for item in estimates]) ** -2.0
    mean = weight @ value / weight.sum()
    return float(weight @ (value - mean) ** 2 / (len(value) - 1))
