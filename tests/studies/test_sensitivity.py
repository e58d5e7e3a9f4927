# SPDX-License-Identifier: Apache-2.0
"""Sensitivities of formulas whose answer is known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from taccel_lab.studies.report.sensitivity import sensitivity


def grid(*columns: list[float]) -> list[tuple[float, ...]]:
    return list(itertools.product(*columns))


def test_powers_are_elasticities() -> None:
    points = grid([1, 2, 4], [0.1, 0.3, 0.9])
    t, e = (list(column) for column in zip(*points, strict=True))
    found = sensitivity({"t": t, "e": e}, [7 * a**-1.5 * b**0.5 for a, b in points], grid=True)
    assert found.effects["t"].elasticity == pytest.approx(-1.5)
    assert found.effects["e"].elasticity == pytest.approx(0.5)
    assert found.r2 == pytest.approx(1) and found.count == 9


def test_shares_of_a_sum_add_up() -> None:
    points = grid([1, 2, 3], [10, 30])
    t, e = (list(column) for column in zip(*points, strict=True))
    found = sensitivity({"t": t, "e": e}, [a + b for a, b in points], grid=True)
    # Variances of the levels: 2/3 and 100.
    assert found.effects["t"].share == pytest.approx((2 / 3) / (100 + 2 / 3))
    assert found.effects["e"].share == pytest.approx(100 / (100 + 2 / 3))
    assert (found.effects["e"].low, found.effects["e"].high) == (12, 32)
    assert found.effects["e"].rank is None


def test_ranks_see_any_rise() -> None:
    x = np.linspace(1, 9, 30)
    z = np.resize([1.0, 2.0, 3.0], 30)
    found = sensitivity({"x": list(x), "z": list(z)}, list(-np.exp(x)), grid=False)
    assert found.effects["x"].rank == pytest.approx(-1)
    assert abs(found.effects["z"].rank or 0) < 0.3
    assert found.effects["x"].elasticity is None, "a negative metric has no logarithm"
    assert found.effects["x"].share is None


def test_choices_have_a_share_only() -> None:
    found = sensitivity({"rim": ["a", "a", "b", "b"]}, [1.0, 1.0, 3.0, 3.0], grid=True)
    assert found.effects["rim"].share == pytest.approx(1)
    assert found.effects["rim"].elasticity is None


def test_missing_and_constant_figures() -> None:
    found = sensitivity({"x": [1.0, 2.0, 3.0]}, [1.0, None, 3.0], grid=False)
    assert found.count == 2
    same = sensitivity({"x": [1.0, 2.0, 3.0, 4.0]}, [5.0] * 4, grid=True).effects["x"]
    assert same.share is None and same.elasticity is None and same.rank is None
    flat = sensitivity({"x": [0.0, 2.0, 3.0, 4.0]}, [5.0, 6.0, 7.0, 8.0], grid=False).effects["x"]
    assert flat.elasticity is None and flat.rank == pytest.approx(1)
