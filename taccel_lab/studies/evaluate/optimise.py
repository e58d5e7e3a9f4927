# SPDX-License-Identifier: Apache-2.0
"""Optimiser-driven sweeps with NLopt: every design tried is a row, none is tried twice.

**SLSQP** goes along derivatives, which are differences to a neighbour of each parameter. Neighbours
are tried together with their design: those of a modulus share its simulation. Parameters and
figures are logarithms where they can be, in which figures of presses are nearly straight.
**COBYLA** needs none, and goes on where there are none: parameters in steps, figures that are
missing or do not move.

The variables are the axes mapped to [0, 1]. Objective and constraints are divided by the size of
their first value, so that algorithms which weigh them against each other are not misled by units.
Neither draws anything: a resumed study replays its stored designs and goes on where it stopped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from taccel_lab.studies.evaluate.design_row import TOLERANCE
from taccel_lab.studies.spec.axis import Axis
from taccel_lab.studies.spec.study_file import Constraint, Objective, Sweep

STEP = 0.02
"""Step to a neighbour, as a part of a range: presses stop at residuals of 1e-4, far below what
figures change by over it."""
SMALLEST_GAIN = 1e-3
"""Relative change of the objective at which SLSQP is done: a tenth of what presses tell apart."""
CONSTRAINT_TOLERANCE = 1e-6
"""Violation, as a part of the bound, that is none to NLopt."""

Figures = Mapping[str, float | None]
Try = Callable[[dict[str, Any]], Figures]
"""Figures of the design with these values; a missing one is None."""
Prepare = Callable[[Sequence[dict[str, Any]]], None]
"""Evaluates several designs together before they are tried one by one."""


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
    prepare: Prepare = lambda designs: None,
) -> OptimiserState:
    """Try designs until the method is content or ``sweep.count`` different ones are tried."""
    import nlopt

    problem = _Problem(axes, objective, constraints, sweep.count or 1, attempt)
    start = [_start(axis) for axis in axes]
    stopped = ""
    if sweep.method == "LD_SLSQP":
        stopped = _follow_slopes(nlopt, _Slopes(problem, prepare), sweep, start)
        start = problem.best or start
    if not stopped:
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


def _follow_slopes(nlopt: Any, slopes: _Slopes, sweep: Sweep, start: list[float]) -> str:
    """Run SLSQP; returns why it stopped, empty where a derivative is missing."""
    optimizer = nlopt.opt(nlopt.LD_SLSQP, len(start))
    optimizer.set_xtol_abs(sweep.tolerance)
    optimizer.set_ftol_abs(SMALLEST_GAIN)
    guard = _Guard(optimizer.force_stop)
    optimizer.set_min_objective(lambda x, gradient: guard(slopes.value, x, gradient, None))
    for place in range(len(slopes.problem.bounds)):
        optimizer.add_inequality_constraint(
            lambda x, gradient, place=place: guard(slopes.value, x, gradient, place),
            CONSTRAINT_TOLERANCE,
        )
    try:
        return _drive(nlopt, optimizer, guard, sweep, slopes.places_of(start))
    except _NoSlopeError:
        return ""


def _search(nlopt: Any, problem: _Problem, sweep: Sweep, start: list[float]) -> str:
    """Run COBYLA; returns why it stopped."""
    optimizer = nlopt.opt(nlopt.LN_COBYLA, len(start))
    optimizer.set_xtol_abs(sweep.tolerance)
    optimizer.set_initial_step(0.25)
    guard = _Guard(optimizer.force_stop)
    optimizer.set_min_objective(lambda x, gradient: guard(problem.cost, x))
    for place in range(len(problem.bounds)):
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


class _NoSlopeError(Exception):
    """There is no derivative here."""


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
        self.axes, self.objective, self._count = axes, objective, count
        self._attempt = attempt
        self._known: dict[tuple[Any, ...], Figures] = {}
        self._scales: dict[str, float] = {}
        self._worst: dict[str, float] = {}
        self._missing: dict[tuple[Any, str], float] = {}
        self._least = math.inf
        self.least_violating: list[float] = []
        """Place of the design that comes nearest to the constraints."""
        self.best: list[float] = []
        """Place of the best design that keeps them."""
        self._least_cost = math.inf
        self.state = OptimiserState()
        self.bounds = [bound for constraint in constraints for bound in constraint.bounds]

    def swept(self, x: Sequence[float]) -> dict[str, Any]:
        """Values of the axes at a place."""
        return {a.name: a.at(float(unit)) for a, unit in zip(self.axes, x, strict=True)}

    def figures(self, x: Sequence[float]) -> Figures:
        """Figures of the design at a place."""
        swept = self.swept(x)
        values = tuple(swept.values())
        if values not in self._known:
            if self.used_up:
                raise _OutOfDesigns
            self.state.tried.append(swept)
            self._known[values] = self._attempt(swept)
        return self._known[values]

    def untried(self, places: Sequence[Sequence[float]]) -> list[dict[str, Any]]:
        """Designs at places that are not known yet, as many as may still be tried."""
        new = {tuple(s.values()): s for s in map(self.swept, places)}
        left = [swept for values, swept in new.items() if values not in self._known]
        return left[: self._count - len(self._known)]

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
        total = sum(max(self.excess(x, place), 0.0) for place in range(len(self.bounds)))
        if total < self._least:
            self._least, self.least_violating = total, [float(unit) for unit in x]
        return total

    def cost(self, x: Sequence[float]) -> float:
        """The objective, less is better."""
        figures = self.figures(x)
        violation = self.violation(x)
        value = figures.get(self.objective.metric)
        if value is not None and violation <= TOLERANCE:
            cost = self.objective.sign * value
            if cost < self._least_cost:
                self._least_cost, self.best = cost, [float(unit) for unit in x]
        name = "objective"
        if value is None:
            return self._penalty(figures, name)
        return self._seen(name, self.objective.sign * value / self._scale(name, value))

    def excess(self, x: Sequence[float], place: int) -> float:
        """How far a constraint is exceeded; at most 0 where it is kept."""
        bound = self.bounds[place]
        figures = self.figures(x)
        value = figures.get(bound.metric)
        name = f"{bound.metric} {bound.side}"
        if value is None:
            return max(self._penalty(figures, name), 1.0)
        return self._seen(name, bound.beyond(value) / self._scale(name, bound.limit or value))

    def _scale(self, name: str, value: float) -> float:
        if name not in self._scales:
            self._scales[name] = abs(value) if math.isfinite(value) and value else 1.0
        return self._scales[name]

    def _seen(self, name: str, value: float) -> float:
        self._worst[name] = max(self._worst.get(name, value), value)
        return value

    def _penalty(self, figures: Figures, name: str) -> float:
        """Value in place of a figure that a design lacks: worse than the worst so far.

        The same design keeps its penalty, whatever comes later.
        """
        worst = self._worst.get(name, 1.0)
        return self._missing.setdefault((id(figures), name), worst + max(abs(worst), 1.0))


class _Slopes:
    """The problem as SLSQP sees it: figures with their derivatives."""

    def __init__(self, problem: _Problem, prepare: Prepare) -> None:
        self.problem, self._prepare = problem, prepare

    def places_of(self, units: Sequence[float]) -> list[float]:
        """Variables of units: where the logarithm of a value lies between those of the ends."""
        found = []
        for axis, unit in zip(self.problem.axes, units, strict=True):
            bent = axis.low > 0 and not axis.log and not axis.whole and axis.values is None
            found.append(
                math.log(axis.at(unit) / axis.low) / math.log(axis.high / axis.low)
                if bent
                else unit
            )
        return found

    def _units_of(self, places: Sequence[float]) -> list[float]:
        found = []
        for axis, place in zip(self.problem.axes, places, strict=True):
            if axis.whole or axis.values is not None:
                raise _NoSlopeError
            bent = axis.low > 0 and not axis.log
            found.append(
                axis.unit_of(axis.low * (axis.high / axis.low) ** place) if bent else place
            )
        return found

    def value(self, x: Sequence[float], gradient: Any, place: int | None) -> float:
        """The objective, or the excess of a constraint; ``gradient`` is filled in where it has
        room. Its designs are evaluated together."""
        around = [self._units_of(x)]
        steps = []
        for k in range(len(x)):
            beside = [float(v) for v in x]
            steps.append(STEP if beside[k] + STEP <= 1 else -STEP)
            beside[k] += steps[-1]
            around.append(self._units_of(beside))
        self._prepare(self.problem.untried(around))
        here, *others = (self._measure(units, place) for units in around)
        slopes = [(there - here) / step for there, step in zip(others, steps, strict=True)]
        if place is None and not any(slopes):
            raise _NoSlopeError
        if gradient.size:
            gradient[:] = slopes
        return here

    def _measure(self, units: Sequence[float], place: int | None) -> float:
        problem = self.problem
        if place is None:
            problem.cost(units)
            metric, limit, sign = problem.objective.metric, 1.0, problem.objective.sign
        else:
            bound = problem.bounds[place]
            metric, limit, sign = bound.metric, bound.limit, bound.sign
        value = problem.figures(units).get(metric)
        if value is None or value <= 0 or limit <= 0:
            raise _NoSlopeError
        return sign * math.log(value / limit)
