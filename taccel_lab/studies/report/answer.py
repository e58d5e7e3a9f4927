# SPDX-License-Identifier: Apache-2.0
"""The answer of a study: the best design, what limits it, and how far its parameters are known.

**Limits**: constraints that every better-ranked design breaks; without such designs, the ends of
ranges at which the best design stands, where going on would improve the goal.

**Interval of a parameter**: values of feasible designs whose goal lies within ``TELL_APART`` of the
best, since presses of the default accuracy do not tell them apart. Where a constraint limits the
answer, also the values at which the softest and the stiffest gel that the design may be
(``evaluate.evaluate.Unknowns``) would just keep it: x (bound / end)^(1/e), with the figure's
elasticity e.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from taccel_lab.report.page import format_number
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.studies.evaluate.design_row import DesignRow, is_feasible, violations
from taccel_lab.studies.evaluate.runner import StudyOutcome
from taccel_lab.studies.report.sensitivity import Sensitivity
from taccel_lab.studies.spec.axis import Axis

if TYPE_CHECKING:
    from taccel_lab.studies.spec.study_file import Constraint, Objective


TELL_APART = 0.03
"""Relative difference of a goal below which designs count as equal: the error of a press."""
MOST_STEEP = 10.0
"""1 / |elasticity| beyond which a figure hardly depends on the parameter, and bounds none."""


@dataclass(frozen=True)
class Limit:
    """What keeps the best design from being better."""

    name: str
    """Name of the constraint's metric, or of the parameter."""
    text: str


@dataclass(frozen=True)
class Answer:
    """The best design of a study."""

    design: str
    """Its id."""
    limits: tuple[Limit, ...]
    """Empty where the goal has its optimum inside all ranges."""
    intervals: dict[str, tuple[float, float]]
    """Ends by parameter with numbers, in the parameter's unit."""


def answer(
    best: DesignRow,
    rows: Sequence[DesignRow],
    goal: Objective,
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
    least = goal.cost(best.figures)
    equal = [
        row
        for row in rows
        if is_feasible(row, constraints)
        and goal.cost(row.figures) - least <= TELL_APART * abs(least)
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
    best: DesignRow, rows: Sequence[DesignRow], goal: Objective, constraints: Sequence[Constraint]
) -> list[Constraint]:
    """Constraints that every design with a better goal breaks; where none is common, all of
    theirs."""
    sets = [
        set(violations(row, constraints))
        for row in rows
        if row.status == "done" and goal.cost(row.figures) < goal.cost(best.figures)
    ]
    sets = [broken for broken in sets if broken]
    if not sets:
        return []
    common = set.intersection(*sets) or set.union(*sets)
    return [c for c in constraints if c.metric in common]


def _ends_of_ranges(
    best: DesignRow, goal: Objective, axes: Sequence[Axis], found: Mapping[str, Sensitivity]
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


@dataclass(frozen=True)
class StudyVerdict:
    """How a study ended."""

    good: bool
    """Whether it has finished and some design keeps the bounds."""
    headline: str
    sentences: tuple[str, ...]
    """What was found."""
    remarks: tuple[Remark, ...]
    """What is wrong or missing."""


def study_verdict(outcome: StudyOutcome, values: dict[str, Any]) -> StudyVerdict:
    """Headline and sentences; good when the study has finished and some design keeps the bounds."""
    counts, spec = values["counts"], outcome.study.spec
    remarks = []

    def remark(severity: Severity, code: str, message: str) -> None:
        remarks.append(Remark(severity, code, message))

    good = False
    if not counts["done"]:
        headline = "No design has figures"
        remark(Severity.ERROR, "no_figures", "No design has a figure; causes below.")
    elif spec.constraints and not counts["feasible"]:
        headline = "No design keeps the constraints"
        remark(Severity.ERROR, "no_feasible_design", _nearest_sentence(outcome, values))
    elif not outcome.complete:
        headline = f"{counts['rows']} of {counts['designs']} designs are done"
    else:
        headline = f"{counts['done']} designs compared"
        if spec.constraints:
            headline += f", {counts['feasible']} keep the constraints"
        good = True
    if not outcome.complete:
        text = "The study is not finished; the same command continues it."
        remark(Severity.WARNING, "not_finished", text)
    if counts["failed"]:
        lost = f"{counts['failed']} design{'s' if counts['failed'] > 1 else ''}"
        text = f"{lost} cannot be built or pressed; causes below."
        remark(Severity.WARNING, "failed_designs", text)
    if counts["broken"]:
        text = f"{counts['broken']} designs were lost to faults; the next run tries them again."
        remark(Severity.WARNING, "lost_designs", text)
    for text in _holes(outcome, values):
        remark(Severity.WARNING, "designs_without_figures", text)
    if values["gaps"]:
        text = "Some figures are missing; causes below."
        remark(Severity.WARNING, "missing_figures", text)
    sentences = _answer_sentences(outcome, values) if values["best"] else []
    if values["optimiser"]:
        sentences.append(
            f"The optimiser {spec.sweep.method} tried {counts['designs']} designs and stopped: "
            f"{values['optimiser']}."
        )
    sentences += _strongest(values)
    return StudyVerdict(good, headline, tuple(sentences), tuple(remarks))


def _answer_sentences(outcome: StudyOutcome, values: dict[str, Any]) -> list[str]:
    """The best design, the range of each of its parameters, and what limits it."""
    row = next(row for row in outcome.rows if row.id == values["best"][0])
    metric = values["goal_metric"]
    unit = values["metrics"][metric]["unit"]
    unit = "" if unit in ("", "1") else f" {unit}"
    found = values["answer"]
    ranges = ", ".join(
        f"{name} {format_number(low)} to {format_number(high)}"
        for name, (low, high) in found["intervals"].items()
        if low < high
    )
    limits = "; ".join(limit["text"] for limit in found["limits"])
    return [
        f"The {values['goal']}, {format_number(row.figures[metric])}{unit}, "
        f"has {values['names'][row.id]}.",
        f"Range of the answer: {ranges}."
        if ranges
        else f"All other designs are over {100 * TELL_APART:g} % worse.",
        f"Limited by {limits}." if limits else "No constraint and no range limits it.",
    ]


def _nearest_sentence(outcome: StudyOutcome, values: dict[str, Any]) -> str:
    nearest = values["nearest"]
    if nearest is None:
        return "No design has all the figures that the constraints are about."
    bounds = {c.metric: c.text() for c in outcome.study.spec.constraints}
    missed = "; ".join(
        f"{bounds[name]} is missed by {format_number(excess)} {values['metrics'][name]['unit']}"
        for name, excess in nearest["violations"].items()
    )
    return f"Nearest comes {values['names'][nearest['design']]}: {missed}."


def _holes(outcome: StudyOutcome, values: dict[str, Any]) -> list[str]:
    """What designs without figures take from the means of a grid."""
    lacking = {name: found["lacking"] for name, found in values["sensitivities"].items()}
    most = max(lacking.values(), default=0)
    if outcome.study.spec.sweep.kind != "grid" or not most:
        return []
    metrics = ", ".join(name for name, count in lacking.items() if count == most)
    return [
        f"{most} of {values['counts']['designs']} designs have no {metrics}. Means over a "
        "parameter compare only designs that have a figure at each of its values with all other "
        "parameters the same; the sensitivities say how many those are."
    ]


def _strongest(values: dict[str, Any]) -> list[str]:
    """Which parameter moves the goal's metric most."""
    if not values["goal"]:
        return []
    metric = values["goal_metric"]
    effects = values["sensitivities"][metric]["effects"]
    known = {n: e["elasticity"] for n, e in effects.items() if e["elasticity"] is not None}
    if not known:
        return []
    name = max(known, key=lambda key: abs(known[key]))
    return [
        f"{name} moves {metric} most: one percent more of it changes it by {known[name]:+.2f} "
        "percent."
    ]
