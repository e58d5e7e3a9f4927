# SPDX-License-Identifier: Apache-2.0
"""The figures of a study's report as one nested dictionary: the JSON, and what the page shows."""

from __future__ import annotations

import platform
from dataclasses import asdict
from typing import Any

import numpy as np

from taccel_lab.studies.evaluate.design_row import (
    DesignRow,
    directed,
    is_feasible,
    least_violating,
    ranked,
    violations,
)
from taccel_lab.studies.evaluate.runner import StudyOutcome
from taccel_lab.studies.evaluate.study_folder import table_rows
from taccel_lab.studies.report.answer import answer
from taccel_lab.studies.report.sensitivity import Sensitivity, sensitivity
from taccel_lab.version import __version__


def pareto_front(costs: np.ndarray) -> np.ndarray:
    """Rows that no other row dominates, as a mask, shape [design].

    Row a dominates b when it is nowhere worse and somewhere better. Equal rows do not dominate each
    other. Rows with NaN are on no front.

    Args:
        costs: Less is better, shape [design, metric].
    """
    costs = np.asarray(costs, dtype=np.float64)
    known = np.array(np.isfinite(costs).all(axis=1))
    front = np.array(known)
    for row in np.flatnonzero(known):
        others = costs[known]
        no_worse = (others <= costs[row]).all(axis=1)
        better = (others < costs[row]).any(axis=1)
        front[row] = not (no_worse & better).any()
    return front


COMPARED = 3
"""Best and worst designs that the page shows side by side, of each at most."""


def report_values(outcome: StudyOutcome, found: dict[str, Sensitivity]) -> dict[str, Any]:
    """Everything that the report says; ``found`` are the sensitivities by metric."""
    study, rows = outcome.study, outcome.rows
    spec = study.spec
    done = outcome.done
    goal = next(iter(directed(spec.goals, study.metrics)), None)
    order = ranked(rows, goal, spec.constraints) if goal else []
    nearest = None
    if spec.constraints and not any(is_feasible(row, spec.constraints) for row in rows):
        nearest = least_violating(rows, spec.constraints)
    best, worst = _ends(order)
    return {
        "study": spec.study.name,
        "sensor": study.family.name,
        "sensor_title": study.family.title,
        "sweep": spec.sweep.model_dump(),
        "seed": spec.study.seed,
        "accuracy": spec.study.accuracy.value,
        "presses": list(study.presses),
        "fixed": dict(spec.fixed),
        "unit_spread_percent": spec.study.unit_spread_percent,
        "goal": goal.text() if goal else None,
        "goal_metric": goal.metric if goal else None,
        "constraints": [constraint.text() for constraint in spec.constraints],
        "counts": {
            "designs": outcome.total,
            "rows": len(rows),
            "done": len(done),
            "failed": sum(row.status == "failed" for row in rows),
            "broken": sum(row.status == "broken" for row in rows),
            "feasible": sum(is_feasible(row, spec.constraints) for row in rows),
            "missing": outcome.total - len(rows),
            "others": outcome.others,
        },
        "complete": outcome.complete,
        "names": {row.id: study.name_of(row.parameters) for row in rows},
        "best": [row.id for row in best],
        "worst": [row.id for row in worst],
        "answer": asdict(answer(best[0], rows, goal, spec.constraints, study.axes, found))
        if goal and best
        else None,
        "nearest": None
        if nearest is None
        else {"design": nearest.id, "violations": violations(nearest, spec.constraints)},
        "optimiser": None if outcome.optimiser is None else outcome.optimiser.stopped,
        "parameters": {axis.name: _parameter(outcome, axis.name) for axis in study.axes},
        "metrics": _metrics(outcome, done),
        "pareto": _pareto(outcome),
        "sensitivities": {name: asdict(s) for name, s in found.items()},
        "failures": [
            {"design": row.id, "status": row.status, "cause": row.cause, **row.parameters}
            for row in rows
            if row.status != "done"
        ],
        "gaps": _gaps(done),
        "curves": _curves(outcome),
        "cost": _cost(outcome),
        "designs": table_rows(study, rows),
    }


def _ends(order: list[DesignRow]) -> tuple[list[DesignRow], list[DesignRow]]:
    """The best and the worst designs, no design in both."""
    count = min(COMPARED, (len(order) + 1) // 2)
    return order[:count], order[max(count, len(order) - count) :][::-1]


def _parameter(outcome: StudyOutcome, name: str) -> dict[str, Any]:
    parameter = outcome.study.parameters[name]
    values = [row.parameters[name] for row in outcome.rows]
    numeric = not parameter.choices and bool(values)
    return {
        "label": parameter.label,
        "unit": parameter.unit,
        "description": parameter.description,
        "default": parameter.default,
        "low": min(values) if numeric else None,
        "high": max(values) if numeric else None,
        "values": len(set(values)),
    }


def _metrics(outcome: StudyOutcome, done: list[DesignRow]) -> dict[str, dict[str, Any]]:
    found = {}
    for name, metric in outcome.study.metrics.items():
        values = [v for row in done if (v := row.figures.get(name)) is not None]
        found[name] = {
            "unit": metric.unit,
            "better": metric.better,
            "description": metric.description,
            "presses": list(metric.presses),
            "low": min(values, default=None),
            "median": float(np.median(values)) if values else None,
            "high": max(values, default=None),
            "missing": len(done) - len(values),
        }
    return found


def compared(outcome: StudyOutcome) -> dict[str, float]:
    """Metrics with a better side that differ between designs: the goal, then those of constraints;
    1 where less is better, -1 where more is."""
    spec = outcome.study.spec
    goals = directed(spec.goals, outcome.study.metrics)
    signs = {goal.metric: goal.sign for goal in goals[: max(len(spec.goals), 1)]}
    for constraint in spec.constraints:
        if (constraint.min is None) != (constraint.max is None):
            signs.setdefault(constraint.metric, 1.0 if constraint.min is None else -1.0)
    signs |= {goal.metric: goal.sign for goal in goals if goal.metric not in signs}
    return {
        name: sign
        for name, sign in signs.items()
        if len({row.figures.get(name) for row in outcome.done} - {None}) > 1
    }


def costs_of(designs: list[DesignRow], signs: dict[str, float]) -> np.ndarray:
    """Less is better, NaN where a figure is missing, shape [design, metric]."""
    table = [
        [
            np.nan if (v := row.figures.get(name)) is None else sign * v
            for name, sign in signs.items()
        ]
        for row in designs
    ]
    return np.array(table, dtype=np.float64).reshape(len(designs), len(signs))


def _pareto(outcome: StudyOutcome) -> dict[str, Any] | None:
    """Designs that no feasible one beats: in the first two metrics with a better side, and in all.

    With many metrics most designs are on the front of all of them.
    """
    spread = compared(outcome)
    if len(spread) < 2:
        return None
    feasible = [row for row in outcome.done if is_feasible(row, outcome.study.spec.constraints)]
    first = dict(list(spread.items())[:2])

    def front(signs: dict[str, float]) -> list[str]:
        on_front = pareto_front(costs_of(feasible, signs))
        return [row.id for row, on in zip(feasible, on_front, strict=True) if on]

    return {
        "metrics": list(spread),
        "designs": front(spread),
        "first_metrics": list(first),
        "first_designs": front(first),
    }


def sensitivities(outcome: StudyOutcome) -> dict[str, Sensitivity]:
    """Sensitivities by metric; of a grid over all its designs, those without a row too."""
    grid = outcome.study.spec.sweep.kind == "grid"
    figures = {row.id: row.figures for row in outcome.rows}
    designs = outcome.study.points() if grid else outcome.done
    columns = {a.name: [d.parameters[a.name] for d in designs] for a in outcome.study.axes}
    return {
        name: sensitivity(columns, [figures.get(d.id, {}).get(name) for d in designs], grid=grid)
        for name in outcome.study.metrics
    }


def _gaps(done: list[DesignRow]) -> list[dict[str, Any]]:
    """Causes of figures that designs lack, with the designs."""
    found: dict[tuple[str, str], list[str]] = {}
    for row in done:
        for name, cause in row.causes.items():
            found.setdefault((name, cause), []).append(row.id)
    return [{"what": k[0], "cause": k[1], "designs": ids} for k, ids in found.items()]


def _curves(outcome: StudyOutcome) -> list[dict[str, Any]]:
    """Depth, force and contact diameter of the presses straight down, by design and indenter."""
    straight = [n for n, p in outcome.study.presses.items() if getattr(p, "straight", False)]
    return [
        {
            "design": row.id,
            "press": name,
            "indenter": curve["indenter"],
            "depth_mm": curve["depth_mm"],
            "force_n": [force[2] for force in curve["force_n"]],
            "contact_diameter_mm": curve.get("contact_diameter_mm"),
        }
        for row in outcome.done
        for name in straight
        for curve in row.curves.get(name) or []
    ]


def _cost(outcome: StudyOutcome) -> dict[str, Any]:
    rows = outcome.rows
    return {
        "simulations": sum(row.simulations for row in rows),
        "presses": len(rows) * len(outcome.study.presses),
        "process_seconds": sum(row.seconds for row in rows),
        "this_run_seconds": outcome.seconds,
        "this_run_designs": outcome.new,
        "processes": outcome.processes,
        "device": outcome.device,
        "machine": f"{platform.system()} {platform.machine()}",
        "tool_version": __version__,
        "versions_of_rows": sorted({row.tool_version for row in rows}),
    }
