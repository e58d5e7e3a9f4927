# SPDX-License-Identifier: Apache-2.0
"""The answer of a study: the best design, what limits it, and how far its parameters are known.

**Limits**: constraints that every better-ranked design breaks; without such designs, the ends of
ranges at which the best design stands, where going on would improve the goal.

**Interval of a parameter**: values of feasible designs whose goal lies within ``TELL_APART`` of the
best, since presses of the default accuracy do not tell them apart. Where a constraint limits the
answer, also the values at which the softest and the stiffest gel that the design may be
(``studies.unknowns``) would just keep it: x (bound / end)^(1/e), with the figure's elasticity e.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.ranking import Goal, is_feasible, violations
from taccel_lab.studies.report.sensitivity import Sensitivity
from taccel_lab.studies.spec.axis import Axis

if TYPE_CHECKING:
    from taccel_lab.studies.spec.study_file import Constraint

TELL_APART = 0.03
"""Relative difference of a goal below which designs count as equal: the error of a press."""
MOST_STEEP = 10.0
"""1 / |elasticity| beyond which a figure hardly depends on the parameter, and bounds none."""


@dataclass(frozen=True)
class Limit:
    """What keeps the best design from being better."""

    name: str
    """Of the constraint's metric, or of the parameter."""
    text: str


@dataclass(frozen=True)
class Answer:
    """The best design of a study."""

    design: str
    """Its id."""
    limits: tuple[Limit, ...]
    """Empty where the goal has its optimum inside all ranges."""
    intervals: dict[str, tuple[float, float]]
    """By parameter with numbers: from and to, in the parameter's unit."""


def answer(
    best: DesignRow,
    rows: Sequence[DesignRow],
    goal: Goal,
    constraints: Sequence[Constraint],
    axes: Sequence[Axis],
    found: Mapping[str, Sensitivity],
) -> Answer:
    """The answer that a study's rows give.

    Args:
        best: The best of the feasible ``rows``.
        found: Sensitivities by metric.
    """
    broken = _constraints_in_the_way(best, rows, goal, constraints)
    numeric = [axis for axis in axes if axis.numeric]
    limits = [Limit(c.metric, c.text()) for c in broken]
    if not limits:
        limits = _ends_of_ranges(best, goal, numeric, found)
    equal = [
        row
        for row in rows
        if is_feasible(row, constraints)
        and goal.cost(row) - goal.cost(best) <= TELL_APART * abs(goal.cost(best))
    ]
    intervals = {}
    for axis in numeric:
        values = [row.parameters[axis.name] for row in (best, *equal)]
        for constraint in broken:
            values += _kept_by_every_gel(best, constraint, axis.name, found[constraint.metric])
        low, high = axis.ends
        intervals[axis.name] = (max(min(values), low), min(max(values), high))
    return Answer(best.id, tuple(limits), intervals)


def _constraints_in_the_way(
    best: DesignRow, rows: Sequence[DesignRow], goal: Goal, constraints: Sequence[Constraint]
) -> list[Constraint]:
    """Those that every design with a better goal breaks; where none is common, all of theirs."""
    sets = [
        set(violations(row, constraints))
        for row in rows
        if row.status == "done" and goal.cost(row) < goal.cost(best)
    ]
    sets = [broken for broken in sets if broken]
    if not sets:
        return []
    common = set.intersection(*sets) or set.union(*sets)
    return [c for c in constraints if c.metric in common]


def _ends_of_ranges(
    best: DesignRow, goal: Goal, axes: Sequence[Axis], found: Mapping[str, Sensitivity]
) -> list[Limit]:
    limits = []
    effects = found[goal.metric].effects
    for axis in axes:
        slope = effects[axis.name].elasticity
        if slope is None:
            continue
        value = best.parameters[axis.name]
        # The cost falls towards larger values where sign times elasticity is negative.
        low, high = axis.ends
        end = low if goal.sign * slope > 0 else high
        if abs(value - end) <= 1e-6 * (high - low):
            limits.append(Limit(axis.name, f"{axis.name}, whose range ends at {end:g}"))
    return limits


def _kept_by_every_gel(
    best: DesignRow, constraint: Constraint, parameter: str, of_figure: Sensitivity
) -> list[float]:
    """Values of the parameter at which each end of the figure's interval would meet the bound."""
    slope, value = of_figure.effects[parameter].elasticity, best.parameters[parameter]
    figure = best.figures[constraint.metric]
    ends = best.intervals.get(constraint.metric)
    if slope is None or abs(slope) * MOST_STEEP < 1 or ends is None or figure is None:
        return []
    bound = constraint.min if constraint.max is None else constraint.max
    if constraint.min is not None and constraint.max is not None:
        bound = min((constraint.min, constraint.max), key=lambda b: abs(b - figure))
    if not bound or bound <= 0:
        return []
    return [value * (bound / end) ** (1 / slope) for end in ends if end is not None and end > 0]
