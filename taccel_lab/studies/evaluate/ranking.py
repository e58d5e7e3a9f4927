# SPDX-License-Identifier: Apache-2.0
"""Which designs keep the constraints, which is best, and how far off the nearest one is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class Goal:
    """What designs are ranked by."""

    metric: str
    sign: float
    """1 where less is better, -1 where more is."""

    def cost(self, design: DesignRow) -> float:
        """Less is better; infinite without a figure."""
        value = design.figures.get(self.metric)
        return float("inf") if value is None else self.sign * value

    def text(self) -> str:
        return ("least " if self.sign > 0 else "greatest ") + self.metric


def directed(objectives: Sequence[Objective], metrics: Mapping[str, Metric]) -> list[Goal]:
    """What designs could be ranked by: the objectives, then the metrics that have a better side."""
    goals = [Goal(objective.metric, objective.sign) for objective in objectives]
    for name, metric in metrics.items():
        if metric.better != "none" and name not in [goal.metric for goal in goals]:
            goals.append(Goal(name, 1.0 if metric.better == "lower" else -1.0))
    return goals


def ranked(
    designs: Sequence[DesignRow], goal: Goal, constraints: Sequence[Constraint]
) -> list[DesignRow]:
    """Feasible designs with a figure, the best first."""
    found = [d for d in designs if is_feasible(d, constraints)]
    return sorted((d for d in found if goal.cost(d) < float("inf")), key=goal.cost)
