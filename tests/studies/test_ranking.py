# SPDX-License-Identifier: Apache-2.0
"""Which designs keep constraints, which are best, which are on the Pareto front."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from taccel_lab.studies.design_row import DesignRow
from taccel_lab.studies.ranking import (
    Goal,
    directed,
    is_feasible,
    least_violating,
    ranked,
    total_violation,
    violations,
)
from taccel_lab.studies.report.pareto import pareto_front
from taccel_lab.studies.spec import Constraint, Objective
from tests.support.fake_kit import METRICS


def design(name: str, status: str = "done", **figures: float | None) -> DesignRow:
    return DesignRow(name, "gelsight", {}, status, figures)  # type: ignore[arg-type]


BOUNDS = [Constraint(metric="a", min=10), Constraint(metric="b", max=1)]


def test_bounds_are_kept_to_a_thousandth() -> None:
    assert is_feasible(design("x", a=10, b=1), BOUNDS)
    assert is_feasible(design("x", a=9.991, b=1.0009), BOUNDS)
    assert not is_feasible(design("x", a=9.98, b=1), BOUNDS)
    assert not is_feasible(design("x", a=None, b=1), BOUNDS)
    assert not is_feasible(design("x", "failed", a=20, b=0), BOUNDS)
    assert violations(design("x", a=8, b=None), BOUNDS) == {"a": 2, "b": None}


def test_the_nearest_design_is_measured_in_parts_of_the_bounds() -> None:
    near, far = design("near", a=8, b=1), design("far", a=10, b=1.5)
    assert total_violation(near, BOUNDS) == 0.2 and total_violation(far, BOUNDS) == 0.5
    assert least_violating([far, design("blank", a=None, b=0), near], BOUNDS) is near
    assert least_violating([design("blank", a=None, b=0)], BOUNDS) is None


def test_ranking_follows_the_goal() -> None:
    designs = [design("x", a=12, b=0.5), design("y", a=30, b=0.9), design("z", a=40, b=3)]
    assert [d.id for d in ranked(designs, Goal("a", -1), BOUNDS)] == ["y", "x"]
    assert [d.id for d in ranked(designs, Goal("b", 1), [])] == ["x", "y", "z"]
    assert [d.id for d in ranked([design("n", a=None)], Goal("a", 1), [])] == []


def test_without_an_objective_the_first_metric_with_a_better_side_counts() -> None:
    assert directed([], METRICS) == [Goal("stiffness", 1), Goal("range", -1), Goal("blur", 1)]
    assert directed([], {"lamps": METRICS["lamps"]}) == []
    found = directed([Objective(maximize="blur")], METRICS)
    assert found == [Goal("blur", -1), Goal("stiffness", 1), Goal("range", -1)]


def test_front_of_known_points() -> None:
    costs = np.array([[1, 5], [2, 3], [3, 3], [4, 1], [2, 3], [5, 5], [np.nan, 0]])
    assert pareto_front(costs).tolist() == [True, True, False, True, True, False, False]


@given(
    arrays(np.float64, st.tuples(st.integers(1, 12), st.integers(1, 3)), elements=st.integers(0, 4))
)
def test_front_is_beaten_by_nobody_and_beats_the_rest(costs: np.ndarray) -> None:
    front = pareto_front(costs)

    def beats(one: np.ndarray, other: np.ndarray) -> bool:
        return bool((one <= other).all() and (one < other).any())

    assert front.any()
    for row, on_front in zip(costs, front, strict=True):
        assert on_front != any(beats(other, row) for other in costs[front])
