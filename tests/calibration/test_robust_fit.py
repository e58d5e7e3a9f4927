# SPDX-License-Identifier: Apache-2.0
"""The search and robust fit that lenses, planes, grids and materials share, against referees."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize
from scipy.sparse import csr_array

from taccel_lab.calibration.robust_fit import (
    HUBER,
    Expanded,
    RobustFit,
    damped_search,
    fit_robustly,
    robust_scale,
    slopes,
)


def rosenbrock(x: np.ndarray, below: float) -> Expanded:
    residual = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])
    jacobian = np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])
    return float(residual @ residual), 2 * jacobian.T @ residual, 2 * jacobian.T @ jacobian


@pytest.mark.parametrize("high", [np.inf, 0.6])
def test_the_least_within_bounds_is_that_of_scipy(high: float) -> None:
    found, value, ended = damped_search(rosenbrock, np.array([-1.2, 0.5]), high=high)
    bounds = [(None, None if high == np.inf else high)] * 2
    referee = minimize(lambda x: rosenbrock(x, 0.0)[0], [-1.2, 0.5], bounds=bounds, tol=1e-12)
    assert ended
    assert found == pytest.approx(referee.x, abs=1e-4)
    assert value <= referee.fun + 1e-9


def test_held_parameters_stay_and_values_that_are_none_are_not_taken() -> None:
    held = np.array([True, False])
    found, _, _ = damped_search(rosenbrock, np.array([1.2, 0.25]), moving=held)
    assert found[1] == 0.25 and found[0] == pytest.approx(0.5049, abs=1e-3)

    def walled(x: np.ndarray, below: float) -> Expanded:
        value, *derivatives = rosenbrock(x, below)
        return (np.inf if x[1] < 0 else value, *derivatives)  # type: ignore[return-value]

    found, value, _ = damped_search(walled, np.array([-1.2, 1.0]))
    assert found == pytest.approx([1, 1], abs=1e-6) and value < 1e-12


def line(count: int, seed: int, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Design of points on a plane's line, ``x p[:2] + p[2:]``, [2 n, 4], and where they lie."""
    x, rng = np.linspace(-1, 1, count), np.random.default_rng(seed)
    design = np.zeros((2 * count, 4))
    design[0::2, 0] = design[1::2, 1] = x
    design[0::2, 2] = design[1::2, 3] = 1.0
    seen = (design @ [3.0, -2.0, 0.5, 1.0]).reshape(-1, 2)
    return design, seen + rng.normal(0, sigma, (count, 2))


def fitted(design: np.ndarray, seen: np.ndarray, *, robust: bool = True) -> RobustFit:
    return fit_robustly(lambda p: seen - (design @ p).reshape(-1, 2), np.zeros(4), robust=robust)


def test_a_linear_fit_has_the_covariance_of_the_textbook() -> None:
    design, seen = line(40, 0, 0.2)
    for jacobian in (None, lambda _: -design, lambda _: csr_array(-design)):
        fit = fit_robustly(
            lambda p: seen - (design @ p).reshape(-1, 2),
            np.zeros(4),
            jacobian=jacobian,
            robust=False,
        )
        assert fit.x == pytest.approx(np.linalg.lstsq(design, seen.ravel())[0], abs=1e-8)
        variance = float((fit.residuals**2).sum()) / (80 - 4)
        textbook = variance * np.linalg.inv(design.T @ design)
        np.testing.assert_allclose(fit.covariance(), textbook, rtol=1e-4, atol=1e-9)


def test_points_far_off_count_as_huber_has_it() -> None:
    design, seen = line(40, 1, 0.2)
    seen[::9] += (5.0, -4.0)

    def residuals(p: np.ndarray) -> np.ndarray:
        return seen - (design @ p).reshape(-1, 2)

    fit = fitted(design, seen)
    # SciPy's loss of each point's squared length, with the scale that was found.
    limit = HUBER * robust_scale(fit.residuals)
    referee = least_squares(
        lambda p: np.linalg.norm(residuals(p), axis=1), fit.x + 0.1, loss="huber", f_scale=limit
    )
    assert fit.x == pytest.approx(referee.x, abs=1e-4)
    assert (fit.weights[::9] < 0.3).all()


def test_a_turned_picture_is_fitted_alike() -> None:
    """What counts as far off is a length: with u and v by themselves it would be otherwise."""
    design, seen = line(40, 2, 0.2)
    seen[::9] += (3.0, 0.5)
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2)
    straight, turned = fitted(design, seen), fitted(design, seen @ turn.T)
    np.testing.assert_allclose(turned.residuals, straight.residuals @ turn.T, atol=1e-6)


def test_errors_that_a_group_shares_widen_what_they_move() -> None:
    """Groups with a common shift: the mean is as uncertain as the groups are few."""
    spread = []
    for seed in range(60):
        design, seen = line(60, seed, 0.02)
        group = np.arange(60) % 10
        seen = seen + np.random.default_rng(100 + seed).normal(0, 0.3, (10, 2))[group]
        fit = fitted(design, seen, robust=False)
        plain, wide = (np.diag(fit.covariance(groups)) for groups in ((), (group,)))
        assert (wide >= plain * (1 - 1e-9)).all() and wide[2:].mean() > 2 * plain[2:].mean()
        spread.append((fit.x[2:] - (0.5, 1.0)) / np.sqrt(wide[2:]))
    assert np.sqrt(np.mean(np.square(spread))) == pytest.approx(1.0, abs=0.2)


def test_slopes_are_derivatives() -> None:
    found = slopes(
        lambda x: np.array([[x[0] ** 2, np.sin(x[1])], [x[0] * x[1], 1.0]]), np.r_[3, 2.0]
    )
    np.testing.assert_allclose(found, [[6, 0], [0, np.cos(2)], [2, 3], [0, 0]], atol=1e-8)
