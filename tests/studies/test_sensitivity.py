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
    assert found.effects["e"].means == {10: 12, 30: 32}
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


def test_holes_of_a_grid_do_not_bend_the_means() -> None:
    """Thin hard gels break: plain means would make hardness look weaker at every thickness."""
    points = grid([1, 2, 4], [10, 20, 40])
    t, e = (list(column) for column in zip(*points, strict=True))
    truth = {point: point[0] * point[1] for point in points}
    values = [None if p in ((1, 40), (1, 20)) else float(truth[p]) for p in points]
    found = sensitivity({"t": t, "e": e}, values, grid=True)
    assert (found.count, found.lacking) == (7, 2)
    # At 10 every thickness has a figure; at 2 and 4 every hardness.
    assert found.effects["t"].means == {1: 10, 2: 20, 4: 40}
    assert found.effects["t"].compared == 3
    assert found.effects["e"].means == {10: 30, 20: 60, 40: 120}
    assert found.effects["e"].compared == 6
    plain = [np.mean([v for v, (_, h) in zip(values, points, strict=True) if h == at and v])
             for at in (10, 20, 40)]  # fmt: skip
    assert plain[2] / plain[0] > 5, "averages over holes make four times the hardness five times it"


def test_a_level_without_designs_is_a_gap_and_takes_no_other_out() -> None:
    points = grid([1, 2, 4], [10, 20])
    t, e = (list(column) for column in zip(*points, strict=True))
    values = [None if a == 1 else float(a * b) for a, b in points]
    found = sensitivity({"t": t, "e": e}, values, grid=True)
    assert found.effects["t"].means == {1: None, 2: 30, 4: 60} and found.effects["t"].compared == 4


def test_designs_without_partners_have_no_share() -> None:
    points = grid([1, 2], [10, 20])
    t, e = (list(column) for column in zip(*points, strict=True))
    found = sensitivity({"t": t, "e": e}, [1.0, None, None, 4.0], grid=True).effects["t"]
    assert found.compared == 0 and found.share is None and found.means == {1: None, 2: None}
