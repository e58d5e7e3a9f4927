# SPDX-License-Identifier: Apache-2.0
"""Which designs keep the constraints, which is best, and how far off the nearest one is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.metrics.base import Metric
from taccel_lab.studies.spec.study_file import Constraint, Objective

TOLERANCE = 1e-3
"""Part of a bound by which it may be missed: far below what a simulation can tell apart, and what
an optimiser that walks along the bound needs."""


def violations(design: DesignRow, constraints: Sequence[Constraint]) -> dict[str, float | None]:
    """Constraints that a design breaks: by how much [unit of the metric], None without a figure."""
    broken: dict[str, float | None] = {}
    for constraint in constraints:
        value = design.figures.get(constraint.metric)
        if value is None:
            broken[constraint.metric] = None
            continue
        excess = constraint.violation(value)
        if excess > TOLERANCE * _size(constraint, value):
            broken[constraint.metric] = excess
    return broken


def is_feasible(design: DesignRow, constraints: Sequence[Constraint]) -> bool:
    """Whether a design has figures and keeps every constraint to within ``TOLERANCE``."""
    return design.status == "done" and not violations(design, constraints)


def _size(constraint: Constraint, value: float) -> float:
    """Scale of a bound that ``value`` misses."""
    low, high = constraint.min, constraint.max
    bound = low if low is not None and value < low else high
    return abs(bound or 0.0)


def total_violation(design: DesignRow, constraints: Sequence[Constraint]) -> float:
    """Sum of the violations as parts of their bounds; infinite without the figures."""
    total = 0.0
    for constraint in constraints:
        value = design.figures.get(constraint.metric)
        if value is None:
            return float("inf")
        excess = constraint.violation(value)
        total += excess / (_size(constraint, value) or 1.0) if excess else 0.0
    return total


def least_violating(
    designs: Sequence[DesignRow], constraints: Sequence[Constraint]
) -> DesignRow | None:
    """The design that comes nearest to keeping the constraints."""
    found = [d for d in designs if total_violation(d, constraints) < float("inf")]
    return min(found, key=lambda d: total_violation(d, constraints), default=None)


def directed(objectives: Sequence[Objective], metrics: Mapping[str, Metric]) -> list[Objective]:
    """What designs could be ranked by: the objectives, then the metrics that have a better side."""
    goals = list(objectives)
    for name, metric in metrics.items():
        if metric.better != "none" and name not in [goal.metric for goal in goals]:
            side = "minimize" if metric.better == "lower" else "maximize"
            goals.append(Objective(**{side: name}))
    return goals


def ranked(
    designs: Sequence[DesignRow], goal: Objective, constraints: Sequence[Constraint]
) -> list[DesignRow]:
    """Feasible designs with a figure, the best first."""
    found = [d for d in designs if is_feasible(d, constraints)]
    known = [d for d in found if d.figures.get(goal.metric) is not None]
    return sorted(known, key=lambda d: goal.cost(d.figures))
