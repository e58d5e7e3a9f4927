# SPDX-License-Identifier: Apache-2.0
"""Profiles, intervals and polynomials against the exact answers of linear models."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import polynomial
from scipy.stats import t as student

from taccel_lab.calibration.material.interpolation import Axis, ResponseTable
from taccel_lab.calibration.material.likelihood import Group, Likelihood, Parameter

X = np.linspace(0.0, 1.0, 8)


def line(y: np.ndarray, weight: float = 1.0):
    columns = np.stack([X, np.ones_like(X)], axis=1)
    return lambda theta: ((columns @ theta - y) / weight, columns / weight)


def parameters(**changes: Any) -> list[Parameter]:
    return [Parameter("slope", 0.5, -50, 50, 1.0, **changes), Parameter("level", 0, -50, 50, 1.0)]


def test_estimated_noise_gives_the_t_interval() -> None:
    rng = np.random.default_rng(4)
    y = 2 * X + 1 + 0.1 * rng.standard_normal(8)
    found = Likelihood(parameters(), [Group(8, False)], line(y)).solve()
    fit, covariance = np.polyfit(X, y, 1, cov=True)
    assert found.value("slope") == pytest.approx(fit[0], abs=1e-5)
    half = float(student.ppf(0.975, 6)) * np.sqrt(covariance[0, 0])
    low, high = found.profiles["slope"].interval
    assert (low, high) == pytest.approx((fit[0] - half, fit[0] + half), abs=2e-3 * half)
    assert found.sigma_of("slope") == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-4)
    expected = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert found.correlation[0, 1] == pytest.approx(expected, abs=1e-5)


def test_known_noise_gives_the_normal_interval_and_misfit_widens_it() -> None:
    rng = np.random.default_rng(5)
    noise = 0.1 * rng.standard_normal(8)
    y = 2 * X + 1 + noise
    found = Likelihood(parameters(), [Group(8, True)], line(y, 0.1)).solve(["slope"])
    assert not found.misfit and found.chi2_per_dof is not None and found.chi2_per_dof < 3
    sigma = 0.1 / np.sqrt(((X - X.mean()) ** 2).sum())
    low, high = found.profiles["slope"].interval
    assert high - low == pytest.approx(2 * 1.96 * sigma, rel=5e-3)
    too_sure = Likelihood(parameters(), [Group(8, True)], line(y, 0.01)).solve(["slope"])
    assert too_sure.misfit
    low_sure, high_sure = too_sure.profiles["slope"].interval
    assert high_sure - low_sure > 0.7 * (high - low)


def test_a_parameter_without_influence_is_open_on_both_sides() -> None:
    y = 2 * X + 1 + 0.05 * np.sin(40 * X)
    columns = np.stack([X, np.ones_like(X), np.zeros_like(X)], axis=1)
    named = [*parameters(), Parameter("idle", 0.2, 0.0, 1.0, 0.1)]
    found = Likelihood(
        named, [Group(8, False)], lambda theta: (columns @ theta - y, columns)
    ).solve(["idle"])
    profile = found.profiles["idle"]
    assert profile.open_low and profile.open_high
    assert profile.interval == (0.0, 1.0)


def test_a_prior_holds_what_data_leave_open() -> None:
    y = 2 * X + 1
    columns = np.stack([X, np.ones_like(X), np.ones_like(X)], axis=1)  # level twice
    named = [*parameters(), Parameter("twin", 0.3, -5, 5, 0.1, prior_sigma=0.1)]
    found = Likelihood(
        named, [Group(8, True)], lambda theta: ((columns @ theta - y) / 0.01, columns / 0.01)
    ).solve(["twin"])
    assert found.value("twin") == pytest.approx(0.3, abs=1e-3)
    assert found.sigma_of("twin") == pytest.approx(0.1, rel=1e-3)


def test_perfect_data_are_met_exactly() -> None:
    found = Likelihood(parameters(), [Group(8, False)], line(2 * X + 1)).solve()
    assert found.value("slope") == pytest.approx(2.0, abs=1e-6)
    low, high = found.profiles["slope"].interval
    assert low <= 2.0 + 1e-6 and high >= 2.0 - 1e-6 and high - low < 1e-4


def test_three_points_on_a_line_are_not_taken_for_exact() -> None:
    """A usual noise counts like as many readings; without it one degree of freedom says nothing."""
    y = np.array([0.0, 0.5, 1.0])
    x = np.array([0.0, 0.5, 1.0])
    columns = np.stack([x, np.ones(3)], axis=1)
    group = Group(3, False, usual=0.1, usual_count=1.0)
    found = Likelihood(parameters(), [group], lambda theta: (columns @ theta - y, columns)).solve()
    low, high = found.profiles["slope"].interval
    # Variance of (0 + 1 * 0.1^2) over 1 + 1 degrees of freedom, and the t of 2 of them.
    sigma = np.sqrt(0.01 / 2) / np.sqrt(0.5)
    assert high - low == pytest.approx(2 * student.ppf(0.975, 2) * sigma, rel=5e-3)
    assert found.noise == pytest.approx((np.sqrt(0.01 / 2),))


@given(st.integers(1, 4), st.integers(1, 4), st.integers(0, 2**31))
def test_polynomials_through_the_nodes_come_back(m: int, n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = rng.standard_normal((m, n, 2))
    axis, way = Axis(-1.0, 1.0), np.array([0.0, 1.0])
    values = np.moveaxis(polynomial.polygrid2d(axis.nodes(m), axis.nodes(n), true), 0, -1)
    table = ResponseTable.through(axis, axis, way, values)
    for x, y in rng.uniform(-1, 1, (4, 2)):
        expected = polynomial.polyval2d(x, y, true)
        np.testing.assert_allclose(table.at(x, y, way).value, expected, atol=1e-8)
