# SPDX-License-Identifier: Apache-2.0
"""The row of one design, the content of its ``result.json``; which rows keep the constraints, which
is best, and how far off the nearest one is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.files.documents import read_json
from taccel_lab.files.inner_path import require_inner_name
from taccel_lab.files.regular_file import shown
from taccel_lab.studies.metrics.base import Metric
from taccel_lab.studies.spec.study_file import Constraint, Objective

if TYPE_CHECKING:
    from taccel_lab.studies.metrics.design_point import DesignFigures


Status = Literal["done", "failed", "broken"]
"""done: at least one figure. failed: none, for a cause that lies in the design (a pad that cannot
be built). broken: the process died or a fault of the program; tried again by the next run."""


@dataclass(frozen=True)
class DesignRow:
    """One design and its figures, as they stand in a file."""

    id: str
    family: str
    parameters: dict[str, Any]
    """Overrides of the family's defaults."""
    status: Status
    figures: dict[str, float | None] = field(default_factory=dict)
    """Values by metric; None where there is a cause."""
    causes: dict[str, str] = field(default_factory=dict)
    """Reasons by metric, ``press NAME``, or ``design``."""
    seconds: float = 0.0
    """Wall time of the design's process; work that designs share counts in equal parts."""
    simulations: int = 0
    curves: dict[str, Any] = field(default_factory=dict)
    """Steps of each press."""
    figure_keys: dict[str, str] = field(default_factory=dict)
    """Key by metric: stands for the settings of the presses that it was read from."""
    press_keys: dict[str, str] = field(default_factory=dict)
    """Key by press: stands for its settings."""
    files: dict[str, str] = field(default_factory=dict)
    """What was kept, by kind, relative to the study's folder."""
    tool_version: str = ""
    finished: str = ""
    """UTC."""
    intervals: dict[str, list[float | None]] = field(default_factory=dict)
    """Ends by metric of what is known of the figure, None for an open one."""

    @property
    def cause(self) -> str:
        """Why there are figures missing; empty when none is."""
        whole = self.causes.get("design")
        if whole:
            return whole
        return "; ".join(f"{name}: {cause}" for name, cause in self.causes.items())

    @property
    def unbuildable(self) -> bool:
        """Whether the design has no figures at all, and never will."""
        return self.status == "failed" and "design" in self.causes

    def missing(self, figure_keys: Mapping[str, str]) -> tuple[str, ...]:
        """Metrics that were not evaluated, or from presses with other settings."""
        if self.unbuildable:
            return ()
        return tuple(n for n, key in figure_keys.items() if self.figure_keys.get(n) != key)

    def missing_presses(self, press_keys: Mapping[str, str]) -> tuple[str, ...]:
        """Presses that were not made, or with other settings."""
        if self.unbuildable:
            return ()
        return tuple(n for n, key in press_keys.items() if self.press_keys.get(n) != key)

    def merged(self, newer: DesignRow) -> DesignRow:
        """``newer``, with what is only known here."""
        again = {"design", *newer.figures, *(f"press {name}" for name in newer.press_keys)}
        causes = {name: cause for name, cause in self.causes.items() if name not in again}
        figures = {**self.figures, **newer.figures}
        known = any(value is not None for value in figures.values())
        return replace(
            newer,
            status="done" if known and newer.status != "broken" else newer.status,
            figures=figures,
            intervals={**self.intervals, **newer.intervals},
            causes={**causes, **newer.causes},
            seconds=self.seconds + newer.seconds,
            simulations=self.simulations + newer.simulations,
            curves={**self.curves, **newer.curves},
            files={**self.files, **newer.files},
            figure_keys={**self.figure_keys, **newer.figure_keys},
            press_keys={**self.press_keys, **newer.press_keys},
        )

    def to_json(self) -> dict[str, Any]:
        return to_jsonable(asdict(self))


def read_row(path: Path) -> DesignRow:
    """Read a ``result.json``; raises InputError for one that is damaged."""
    values = read_json(path)
    try:
        known = {item.name for item in fields(DesignRow)}
        values = {"intervals": {}, **values}  # Rows of earlier versions have none.
        if set(values) != known:
            raise ValueError(f"keys {sorted(set(values) ^ known)} are missing or unknown")
        if values["status"] not in ("done", "failed", "broken"):
            raise ValueError(f"status {shown(values['status'])}")
        _check_kinds(values)
        return DesignRow(**values)
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path} is damaged: {error}") from error


def _check_kinds(values: dict[str, Any]) -> None:
    """ValueError for a value of another kind than the row's."""
    text_by_name = ("causes", "figure_keys", "press_keys", "files")
    kinds: dict[str, tuple[type, ...]] = dict.fromkeys(values, (str,))
    kinds |= dict.fromkeys(("parameters", "figures", "intervals", "curves", *text_by_name), (dict,))
    kinds |= {"seconds": (int, float), "simulations": (int,)}
    found = {name: (value, kinds[name]) for name, value in values.items()}
    for table in text_by_name:
        if type(values[table]) is dict:
            found |= {f"{table}.{name}": (text, (str,)) for name, text in values[table].items()}
    allowed = (int, float, type(None))
    if type(values["figures"]) is dict:
        found |= {f"figures.{name}": (v, allowed) for name, v in values["figures"].items()}
    if type(values["intervals"]) is dict:
        for name, ends in values["intervals"].items():
            if type(ends) is not list or len(ends) != 2:
                raise ValueError(f"intervals.{name} is {shown(ends)}")
            found |= {f"intervals.{name}.{i}": (end, allowed) for i, end in enumerate(ends)}
    for name, (value, allowed) in found.items():
        if type(value) not in allowed:
            raise ValueError(f"{name} is {shown(value)}")
    for name in values["files"].values():
        require_inner_name(name)


def row_of(
    result: DesignFigures,
    figure_keys: Mapping[str, str],
    press_keys: Mapping[str, str],
    tool_version: str,
    finished: str,
) -> DesignRow:
    """The row of an evaluated design; the keys name its metrics and presses."""
    figures = {name: result.figures.get(name) for name in figure_keys}
    causes = dict(result.causes)
    if whole := causes.get("design"):
        causes = {"design": whole}
    for name, value in figures.items():
        if value is None and not whole and name not in causes:
            causes[name] = "no value, and no cause was given"
    return DesignRow(
        id=result.point.id,
        family=result.point.family,
        parameters=to_jsonable(result.point.parameters),
        status="done" if any(value is not None for value in figures.values()) else "failed",
        figures=to_jsonable(figures),
        intervals=to_jsonable({n: result.intervals[n] for n in figures if n in result.intervals}),
        causes=causes,
        seconds=result.seconds,
        simulations=result.simulations,
        curves=to_jsonable(result.curves),
        figure_keys=dict(figure_keys),
        press_keys=dict(press_keys),
        tool_version=tool_version,
        finished=finished,
    )


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
