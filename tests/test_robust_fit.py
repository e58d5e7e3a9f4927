# SPDX-License-Identifier: Apache-2.0
"""The search and robust fit that lenses and materials share, and cross-conformal bounds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares, minimize
from scipy.sparse import csr_array

from taccel_lab import robust_fit
from taccel_lab.networks.normal_settings import RAYLEIGH_95


def rosenbrock(x: np.ndarray, below: float) -> robust_fit.Expanded:
    residual = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])
    jacobian = np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])
    return float(residual @ residual), 2 * jacobian.T @ residual, 2 * jacobian.T @ jacobian


@pytest.mark.parametrize("high", [np.inf, 0.6])
def test_the_least_within_bounds_is_that_of_scipy(high: float) -> None:
    found, value, ended = robust_fit.damped_search(rosenbrock, np.array([-1.2, 0.5]), high=high)
    bounds = [(None, None if high == np.inf else high)] * 2
    referee = minimize(lambda x: rosenbrock(x, 0.0)[0], [-1.2, 0.5], bounds=bounds, tol=1e-12)
    assert ended and value <= referee.fun + 1e-9
    assert found == pytest.approx(referee.x, abs=1e-4)


def test_held_parameters_stay_and_values_that_are_none_are_not_taken() -> None:
    held = np.array([True, False])
    found, _, _ = robust_fit.damped_search(rosenbrock, np.array([1.2, 0.25]), moving=held)
    assert found[1] == 0.25 and found[0] == pytest.approx(0.5049, abs=1e-3)

    def walled(x: np.ndarray, below: float) -> robust_fit.Expanded:
        value, *derivatives = rosenbrock(x, below)
        return (np.inf if x[1] < 0 else value, *derivatives)  # type: ignore[return-value]

    found, value, _ = robust_fit.damped_search(walled, np.array([-1.2, 1.0]))
    assert found == pytest.approx([1, 1], abs=1e-6) and value < 1e-12


def line(count: int, seed: int, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Design of points on a plane's line, ``x p[:2] + p[2:]``, [2 n, 4], and where they lie."""
    x, rng = np.linspace(-1, 1, count), np.random.default_rng(seed)
    design = np.kron(np.stack([x, np.ones(count)], axis=1), np.eye(2))
    seen = (design @ [3.0, -2.0, 0.5, 1.0]).reshape(-1, 2)
    return design, seen + rng.normal(0, sigma, (count, 2))


def fitted(design: np.ndarray, seen: np.ndarray, **how) -> robust_fit.RobustFit:
    return robust_fit.fit_robustly(lambda p: seen - (design @ p).reshape(-1, 2), np.zeros(4), **how)


def test_a_linear_fit_has_the_covariance_of_the_textbook() -> None:
    design, seen = line(40, 0, 0.2)
    for jacobian in (None, lambda _: -design, lambda _: csr_array(-design)):
        fit = fitted(design, seen, jacobian=jacobian, robust=False)
        assert fit.x == pytest.approx(np.linalg.lstsq(design, seen.ravel())[0], abs=1e-8)
        variance = float((fit.residuals**2).sum()) / (80 - 4)
        textbook = variance * np.linalg.inv(design.T @ design)
        np.testing.assert_allclose(fit.covariance(), textbook, rtol=1e-4, atol=1e-9)


def test_points_far_off_count_as_huber_has_it_whichever_way_the_picture_is_turned() -> None:
    """What counts as far off is a length: with u and v by themselves it would be otherwise."""
    design, seen = line(40, 1, 0.2)
    seen[::9] += (5.0, -4.0)
    fit = fitted(design, seen)
    # SciPy's loss of each point's squared length, with the scale that was found.
    referee = least_squares(
        lambda p: np.linalg.norm(seen - (design @ p).reshape(-1, 2), axis=1),
        fit.x + 0.1,
        loss="huber",
        f_scale=robust_fit.HUBER * robust_fit.robust_scale(fit.residuals),
    )
    assert fit.x == pytest.approx(referee.x, abs=1e-4)
    assert (fit.weights[::9] < 0.3).all()
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2)
    turned = fitted(design, seen @ turn.T)
    np.testing.assert_allclose(turned.residuals, fit.residuals @ turn.T, atol=1e-6)


def test_efficiency_on_normal_noise_is_the_stated_one() -> None:
    """Variance of the mean of normal 2-vectors over that of Huber's estimate, by its influence."""
    length = np.linspace(0, 12, 240_001)
    density = length * np.exp(-(length**2) / 2) * length[1]
    weight = robust_fit.huber_weights(np.stack([length, 0 * length], axis=1), 1.0)
    psi = weight * length
    # Divergence of psi(x) x / |x| in two dimensions.
    slope = np.gradient(psi, length) + weight
    efficiency = (0.5 * np.sum(density * slope)) ** 2 / (0.5 * np.sum(density * psi**2))
    assert efficiency == pytest.approx(0.98, abs=0.004)


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
    found = robust_fit.slopes(
        lambda x: np.array([[x[0] ** 2, np.sin(x[1])], [x[0] * x[1], 1.0]]), np.r_[3, 2.0]
    )
    np.testing.assert_allclose(found, [[6, 0], [0, np.cos(2)], [2, 3], [0, 0]], atol=1e-8)


def press_errors(rng: np.random.Generator, pixels: int = 400) -> np.ndarray:
    """Lengths of heavy-tailed vectors, of a size that differs between presses, as real ones do."""
    vectors = rng.standard_t(4, size=(pixels, 2)) / np.sqrt(2)
    return np.exp(rng.normal(0, 0.25)) * np.linalg.norm(vectors, axis=1)


@pytest.mark.thorough(cases=("36",))
@pytest.mark.parametrize("count", [6, 12, 36])
def test_new_presses_lie_in_the_radius(count: int) -> None:
    rng = np.random.default_rng(count)
    held, normal = [], []
    for _ in range(60):
        factor = robust_fit.radius_factor(
            [press_errors(rng) for _ in range(count)], 0.95, RAYLEIGH_95
        )
        new = press_errors(rng)
        held.append((new <= factor).mean())
        normal.append((new <= RAYLEIGH_95 * np.sqrt((new**2).mean() / 2)).mean())
    assert np.mean(held) == pytest.approx(0.95, abs=0.02)
    assert np.mean(normal) < 0.945  # even with its own scale known, errors are no normal deviates


def test_normal_deviates_keep_their_radius_and_too_few_presses_say_nothing() -> None:
    rng = np.random.default_rng(0)
    presses = [np.linalg.norm(rng.normal(size=(4000, 2)), axis=1) for _ in range(12)]
    assert robust_fit.radius_factor(presses, 0.95, 1.0) == pytest.approx(RAYLEIGH_95, rel=0.02)
    some = [np.ones(5), np.empty(0), np.ones(5), np.ones(5)]
    assert robust_fit.radius_factor(some, 0.95, RAYLEIGH_95) == RAYLEIGH_95


@given(st.floats(0.01, 100.0), st.permutations(range(8)))
def test_the_radius_follows_the_scale_and_not_order_or_pixels_of_presses(scale, order) -> None:
    rng = np.random.default_rng(1)
    presses = [press_errors(rng, 50) for _ in order]
    presses[3] = 3 * presses[3]
    factor = robust_fit.radius_factor(presses, 0.95, 1.0)
    many = [*presses[:3], np.repeat(presses[3], 20), *presses[4:]]
    assert robust_fit.radius_factor(many, 0.95, 1.0) == factor
    found = robust_fit.radius_factor([scale * presses[i] for i in order], 0.95, 1.0)
    assert found == pytest.approx(scale * factor, rel=1e-9)
