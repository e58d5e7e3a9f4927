# SPDX-License-Identifier: Apache-2.0
"""Optimiser-driven sweeps with NLopt's COBYLA: every design tried is a row, none is tried twice.

The variables are the axes mapped to [0, 1]. Objective and constraints are divided by the size of
their first value, so that algorithms which weigh them against each other are not misled by units.
COBYLA draws nothing: a resumed study replays its stored designs and goes on where it stopped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from taccel_lab.studies.axis import Axis
from taccel_lab.studies.ranking import TOLERANCE
from taccel_lab.studies.spec import Constraint, Objective, Sweep

COBYLA = "LN_COBYLA"
"""NLopt's, the one method here without Optuna: local, takes constraints itself."""
CONSTRAINT_TOLERANCE = 1e-6
"""Violation, as a part of the bound, that is none to NLopt."""

Figures = Mapping[str, float | None]
Try = Callable[[dict[str, Any]], Figures]
"""Figures of the design with these values; a missing one is None."""


@dataclass
class OptimiserState:
    """How far an optimiser got."""

    tried: list[dict[str, Any]] = field(default_factory=list)
    """Different designs, in the order of the first try."""
    stopped: str = ""
    """Why it ended, in words."""


def optimise(
    axes: Sequence[Axis],
    objective: Objective,
    constraints: Sequence[Constraint],
    sweep: Sweep,
    attempt: Try,
) -> OptimiserState:
    """Try designs until COBYLA is content or ``sweep.count`` different ones are tried."""
    import nlopt

    problem = _Problem(axes, objective, constraints, sweep.count or 1, attempt)
    start = [_start(axis) for axis in axes]
    stopped = _search(nlopt, problem, sweep, start)
    if constraints and not problem.found_feasible and not problem.used_up:
        # COBYLA weighs cost against constraints and may give up early on unkept ones: the
        # violation alone is minimised then, and the search goes on from a design that keeps them.
        where = _restore(nlopt, problem, sweep)
        if problem.found_feasible:
            stopped = _search(nlopt, problem, sweep, where)
        else:
            stopped += "; then a search for the least violation ended"
    problem.state.stopped = stopped
    return problem.state


def _search(nlopt: Any, problem: _Problem, sweep: Sweep, start: list[float]) -> str:
    """Run COBYLA; returns why it stopped."""
    optimizer = nlopt.opt(nlopt.LN_COBYLA, len(start))
    optimizer.set_xtol_abs(sweep.tolerance)
    optimizer.set_initial_step(0.25)
    guard = _Guard(optimizer.force_stop)
    optimizer.set_min_objective(lambda x, gradient: guard(problem.cost, x))
    for place in range(len(problem.sides)):
        optimizer.add_inequality_constraint(
            lambda x, gradient, place=place: guard(problem.excess, x, place), CONSTRAINT_TOLERANCE
        )
    return _drive(nlopt, optimizer, guard, sweep, start)


def _restore(nlopt: Any, problem: _Problem, sweep: Sweep) -> list[float]:
    """Minimise the violation of the constraints from the least so far; returns where it ended."""
    optimizer = nlopt.opt(nlopt.LN_SBPLX, len(problem.least_violating))
    optimizer.set_xtol_abs(sweep.tolerance)
    optimizer.set_initial_step(0.25)
    optimizer.set_stopval(0.0)
    guard = _Guard(optimizer.force_stop)
    optimizer.set_min_objective(lambda x, gradient: guard(problem.violation, x))
    _drive(nlopt, optimizer, guard, sweep, problem.least_violating)
    return problem.least_violating


def _drive(nlopt: Any, optimizer: Any, guard: _Guard, sweep: Sweep, start: list[float]) -> str:
    """Run an optimiser over the unit cube; returns why it stopped."""
    optimizer.set_lower_bounds(0.0)
    optimizer.set_upper_bounds(1.0)
    # A replayed or rounded design costs nothing, so that the count of tries is no limit by itself.
    optimizer.set_maxeval(50 * (sweep.count or 1) + 1000)
    stopped = "steps became as small as rounding errors"
    try:
        optimizer.optimize(start)
        code = optimizer.last_optimize_result()
        stopped = _RESULTS.get(code, f"NLopt ended with code {code}")
    except (nlopt.RoundoffLimited, nlopt.ForcedStop):
        pass
    if isinstance(guard.error, _OutOfDesigns):
        return "the count of designs was used up"
    if guard.error is not None:
        raise guard.error
    return stopped


class _OutOfDesigns(Exception):
    """The study's count of designs is used up."""


class _Guard:
    """Keeps errors out of NLopt, some of whose methods call on after one: the first stops it."""

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop = stop
        self.error: BaseException | None = None

    def __call__(self, function: Callable[..., float], *arguments: Any) -> float:
        if self.error is None:
            try:
                return function(*arguments)
            except BaseException as error:
                self.error = error
        self._stop()
        return 0.0


_RESULTS = {
    2: "the constraints are kept",
    3: "the objective no longer changed",
    4: "steps fell below the tolerance",
    5: "designs repeated themselves",
}


def _start(axis: Axis) -> float:
    """Where the search begins, in [0, 1]."""
    value = axis.start
    if value is None:
        default = axis.parameter.default
        known = isinstance(default, (int, float)) and axis.low <= default <= axis.high
        value = default if known else None
    if value is None:
        return 0.5
    return min(max(axis.unit_of(float(value)), 0.0), 1.0)


class _Problem:
    """The objective and constraints that NLopt sees, with the designs tried so far."""

    def __init__(
        self,
        axes: Sequence[Axis],
        objective: Objective,
        constraints: Sequence[Constraint],
        count: int,
        attempt: Try,
    ) -> None:
        self._axes, self._objective, self._count = axes, objective, count
        self._attempt = attempt
        self._known: dict[tuple[Any, ...], Figures] = {}
        self._scales: dict[str, float] = {}
        self._worst: dict[str, float] = {}
        self._missing: dict[tuple[Any, str], float] = {}
        self._least = math.inf
        self.least_violating: list[float] = []
        """Place of the design that comes nearest to the constraints."""
        self.state = OptimiserState()
        self.sides = [
            (constraint, side)
            for constraint in constraints
            for side in ("min", "max")
            if getattr(constraint, side) is not None
        ]

    def _figures(self, x: Sequence[float]) -> Figures:
        values = tuple(axis.at(float(unit)) for axis, unit in zip(self._axes, x, strict=True))
        if values not in self._known:
            if self.used_up:
                raise _OutOfDesigns
            swept = {axis.name: value for axis, value in zip(self._axes, values, strict=True)}
            self.state.tried.append(swept)
            self._known[values] = self._attempt(swept)
        return self._known[values]

    @property
    def used_up(self) -> bool:
        """Whether no other design may be tried."""
        return len(self._known) >= self._count

    @property
    def found_feasible(self) -> bool:
        """Whether a design keeps the constraints."""
        return self._least <= TOLERANCE

    def violation(self, x: Sequence[float]) -> float:
        """Sum of all excesses above zero."""
        total = sum(max(self.excess(x, place), 0.0) for place in range(len(self.sides)))
        if total < self._least:
            self._least, self.least_violating = total, [float(unit) for unit in x]
        return total

    def cost(self, x: Sequence[float]) -> float:
        """The objective, less is better."""
        figures = self._figures(x)
        self.violation(x)
        value = figures.get(self._objective.metric)
        name = "objective"
        if value is None:
            return self._penalty(figures, name)
        return self._seen(name, self._objective.sign * value / self._scale(name, value))

    def excess(self, x: Sequence[float], place: int) -> float:
        """How far a constraint is exceeded; at most 0 where it is kept."""
        constraint, side = self.sides[place]
        bound = float(getattr(constraint, side))
        figures = self._figures(x)
        value = figures.get(constraint.metric)
        name = f"{constraint.metric} {side}"
        if value is None:
            return max(self._penalty(figures, name), 1.0)
        beyond = value - bound if side == "max" else bound - value
        return self._seen(name, beyond / self._scale(name, bound or value))

    def _scale(self, name: str, value: float) -> float:
        if name not in self._scales:
            self._scales[name] = abs(value) if math.isfinite(value) and value else 1.0
        return self._scales[name]

    def _seen(self, name: str, value: float) -> float:
        self._worst[name] = max(self._worst.get(name, value), value)
        return value

    def _penalty(self, figures: Figures, name: str) -> float:
        """In the place of a figure that a design does not have: worse than the worst so far.

        The same design keeps its penalty, whatever comes later.
        """
        worst = self._worst.get(name, 1.0)
        return self._missing.setdefault((id(figures), name), worst + max(abs(worst), 1.0))
