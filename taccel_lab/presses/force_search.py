# SPDX-License-Identifier: Apache-2.0
"""A press to a force: how deep it has to go, found by presses that each tell more of the curve."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.guards import require_positive
from taccel_lab.presses.outcome import PressOutcome, PressStep

FORCE_TOLERANCE = 0.01
"""How far a press may end from the force that was asked for, as a part of it."""
ROUGH_TOLERANCE = 0.05
"""The same of presses of lower accuracy, which only say where to begin."""
FIRST_SHARE = 0.1
"""First depth as a part of the deepest one."""
MOST_GROWTH = 3.0
"""Largest step from one depth to the next, as a factor either way: beyond that no law holds."""
MOST_PRESSES = 12
"""Presses allowed; three reach the tolerance as a rule."""

StepProgress = Callable[[int, int, PressStep], None]
PressTo = Callable[[float, StepProgress], PressOutcome]
"""A press to a depth [mm], which tells its steps as ``simulate_press`` does."""


def by_power_law(force_n: np.ndarray, values: np.ndarray, load_n: float) -> float:
    """A quantity at a load, by power laws between the steps of a press, as Hertz's contact has
    them; beside the steps the law of the two nearest goes on.

    ``force_n`` and ``values`` are positive and rise, shape [step], two at least.
    """
    x, y = np.log(force_n), np.log(values)
    k = int(np.clip(np.searchsorted(x, math.log(load_n)) - 1, 0, len(x) - 2))
    slope = (y[k + 1] - y[k]) / (x[k + 1] - x[k])
    return float(math.exp(y[k] + slope * (math.log(load_n) - x[k])))


@dataclass
class _Curve:
    """Normal force over depth of one press, step by step."""

    depth_mm: list[float] = field(default_factory=list)
    force_n: list[float] = field(default_factory=list)

    def add(self, step: PressStep) -> None:
        """Steps sideways count no more, nor does one without contact."""
        force = float(step.wrench[2])
        last = (self.depth_mm[-1], self.force_n[-1]) if self.depth_mm else (0.0, 0.0)
        if step.depth_mm > last[0] and force > last[1]:
            self.depth_mm.append(step.depth_mm)
            self.force_n.append(force)

    def depth_at(self, force_n: float) -> float:
        """Depth [mm] of a force, as far as this curve tells."""
        depth, force = np.array(self.depth_mm), np.array(self.force_n)
        if len(depth) == 1:  # Hertz's law of a ball.
            return float(depth[0] * (force_n / force[0]) ** (2 / 3))
        return by_power_law(force, depth, force_n)


def _told(outcome: PressOutcome, curve: _Curve) -> PressOutcome:
    """The press, its steps told to the curve."""
    for step in outcome.steps:
        curve.add(step)
    return outcome


def press_to_force(
    force_n: float,
    press: PressTo,
    limit_mm: float,
    *,
    first_mm: float | None = None,
    first: PressOutcome | None = None,
    tolerance: float = FORCE_TOLERANCE,
    progress: StepProgress | None = None,
) -> PressOutcome:
    """The press whose normal force, straight down at full depth, is ``force_n`` within
    ``tolerance``: the same as one to its depth, to the last digit, whatever led there.

    Each press tells its whole curve of force over depth, by whose power laws the next one goes.

    Args:
        force_n: Of the gel on the indenter along the press [N].
        press: Presses to a depth, such as a call of ``simulate_press`` with that depth in its path.
        limit_mm: Deepest press.
        first_mm: Where to begin; a tenth of ``limit_mm`` when None.
        first: A press that is there already, in place of the first.
        tolerance: Part of ``force_n``.
        progress: As ``progress`` of ``simulate_press``, for all presses.

    Raises:
        InputError: No such force, or one that is not reached at ``limit_mm``.
        SimulationError: The gel does not converge at a depth that the force needs.
    """
    require_positive("the force of a press", force_n, "N")
    depth_mm = min(FIRST_SHARE * limit_mm if first_mm is None else first_mm, limit_mm)
    if first is not None:
        depth_mm = first.path.depth_mm
    for _ in range(MOST_PRESSES):
        curve = _Curve()

        def tell(done: int, total: int, step: PressStep, curve: _Curve = curve) -> None:
            curve.add(step)
            if progress is not None:
                progress(done, total, step)

        try:
            outcome = press(depth_mm, tell) if first is None else _told(first, curve)
            first = None
        except SimulationError as error:
            # Too deep a guess; what it had passed by then says where to go, if it had.
            if not curve.force_n or curve.force_n[-1] < force_n:
                raise SimulationError(f"{force_n:g} N was not reached: {error}") from error
        else:
            if not curve.force_n:
                raise SimulationError(f"the press to {depth_mm:.3g} mm felt no force")
            if abs(curve.force_n[-1] - force_n) <= tolerance * force_n:
                return outcome
            if depth_mm >= limit_mm and curve.force_n[-1] < force_n:
                raise InputError(
                    f"{force_n:g} N is not reached: the deepest press that this gel allows, "
                    f"{limit_mm:.3g} mm, ends at {curve.force_n[-1]:.3g} N"
                )
        wanted = curve.depth_at(force_n)
        wanted = min(max(wanted, depth_mm / MOST_GROWTH), depth_mm * MOST_GROWTH)
        depth_mm = min(wanted, limit_mm)
    raise SimulationError(
        f"{force_n:g} N was not met within {tolerance:.1%} by {MOST_PRESSES} presses; the last "
        f"went {depth_mm:.4g} mm deep"
    )
