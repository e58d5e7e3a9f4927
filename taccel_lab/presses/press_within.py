# SPDX-License-Identifier: Apache-2.0
"""Presses that measure their error and are refined until it is small enough.

Two coarse presses that differ in ``dhat`` or in the steps give the two parts that are of first
order; the difference between two meshes gives the third. What they are parts of is said in
``press_error``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from taccel_lab.errors import SimulationError
from taccel_lab.presses.press_error import tool_kind
from taccel_lab.presses.press_outcome import PressOutcome
from taccel_lab.scene import Ball, TriangleMesh

COARSE, FINER, FINEST = 0.5**0.5, 2**0.5, 4.0
"""Elements along a side over those of the default: of the first mesh, of each next one over the one
before, and of the last."""
COARSE_SHARE = {Ball: 0.15, TriangleMesh: 0.25}
"""What 19 of 20 presses keep to on the first mesh, of the force and over the depth of the heights:
nothing has been compared yet. Of smooth tools, and of tools that may have rims."""
PAIR_SHARE, FIRST_ORDER_SHARE = 1.0, 1 / (2**0.5 - 1)
"""Error of the finer of two meshes over their difference: of second order, and the most that three
meshes may show, which is that of first order."""
SECOND_ORDER_SHARE = 0.5
"""What second order leaves of a change on the next mesh."""
PAIR_REST, PAIR_HEIGHT_REST = {Ball: 0.007, TriangleMesh: 0.012}, 0.002
"""What two meshes may have in common, of the force and over the depth of the heights; it falls with
the number of elements along a side."""
NEARER = 4.0
"""By what dhat is divided to see what it does."""
PART = 0.25
"""Of the error that is asked for, what dhat and steps may take each."""
SMALLEST_DHAT_M, MOST_STEPS = 2.5e-7, 32
"""Least dhat, and most steps over those of the options."""
MESH_COST = 3.7
"""Time of a press over that on the mesh before."""
UPRIGHT = 0.5
"""Least z of the normals of pixels whose heights are compared: farther down on a dome's side
heights are differences of where a facet happens to end."""


@dataclass(frozen=True)
class Resolution:
    """What a press is refined by."""

    mesh: float
    """Elements along a side over those of the options."""
    dhat_m: float
    steps: int
    """Steps over those of the options."""


AS_IT_IS = Resolution(1.0, math.inf, 1)
"""That of the options; a press takes the smaller of the two ``dhat``."""


@dataclass(frozen=True)
class Parts:
    """Relative errors of the force [1], by cause."""

    mesh: float
    dhat: float
    path: float

    @property
    def total(self) -> float:
        """All of them: causes of one sign add up."""
        return self.mesh + self.dhat + self.path


@dataclass(frozen=True)
class Refinement:
    """How far a press was refined, and what is left."""

    asked: float
    """Relative error of the force that was asked for [1]."""
    parts: Parts
    used: Resolution
    height_error_m: float
    """Error of the heights that is left, root mean square [m]."""
    presses: int
    """How many presses that took."""
    seconds: float
    shortfall: str | None
    """Why the error is larger than asked for, in a sentence; None when it is not."""

    def figures(self) -> dict[str, Any]:
        """As JSON."""
        return {**asdict(self), "stated": self.parts.total}

    def words(self) -> str:
        """What was reached, in a sentence."""
        parts, used = self.parts, self.used
        said = (
            f"{parts.total:.1%} of the force (mesh {parts.mesh:.1%}, contact range "
            f"{parts.dhat:.1%}, steps {parts.path:.1%}) after {self.presses} presses: mesh "
            f"{used.mesh:.3g} times as fine, dhat {1e6 * used.dhat_m:.2g} um, {used.steps} times "
            "the steps"
        )
        if self.shortfall is None:
            return said
        return f"{said}; {self.asked:.1%} was not reached: {self.shortfall}"

    def stated_for(self, outcome: PressOutcome) -> PressOutcome:
        """A press of this resolution with the errors that it states."""
        return replace(
            outcome,
            force_error_n=self.parts.total * abs(_force_n(outcome)),
            height_error_m=self.height_error_m,
        )


PressAt = Callable[[Resolution], PressOutcome]
"""A press of some resolution; SimulationError where it does not converge."""


@dataclass(frozen=True)
class _Found:
    outcome: PressOutcome
    used: Resolution
    parts: Parts
    height_m: float


def press_within(
    share: float,
    press: PressAt,
    dhat_m: float,
    shape: Ball | TriangleMesh,
    *,
    rubs: bool,
    budget_s: float,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[PressOutcome, Refinement]:
    """Press, estimate and refine until the force is known to ``share``, or time is up.

    Args:
        share: Relative error of the force [1].
        press: Does a press.
        dhat_m: Largest contact range [m].
        shape: What presses.
        rubs: Whether there is friction, so that the steps matter.
        budget_s: No finer press than the default's is begun that would presumably end later, and no
            press at all once it is over [s].
        clock: Seconds.

    Returns:
        The finest press, with the stated errors of force and heights, and how it was refined.
        SimulationError as of the first presses; where a finer one fails, the one before is taken.
    """
    started, count, kind = clock(), 0, tool_kind(shape)

    def pressed(at: Resolution) -> PressOutcome:
        nonlocal count
        count += 1
        return press(at)

    used = Resolution(COARSE, dhat_m, 1)
    outcome, predicted = pressed(used), 0.0
    seen = outcome.normals[..., 2] > UPRIGHT
    before = _reading(outcome, seen)
    # Both are of first order: what is left goes with dhat and with the length of the steps.
    near = _reading(pressed(replace(used, dhat_m=dhat_m / NEARER)), seen)
    by_dhat = (before - near) / (1 - 1 / NEARER)
    by_path = np.zeros_like(before)
    if rubs:
        by_path = 2.0 * (before - _reading(pressed(replace(used, steps=2)), seen))
    coarse = COARSE_SHARE[kind]
    best = _found(outcome, used, coarse * before, by_dhat, by_path, rest=0.0)
    best = replace(best, height_m=coarse * 1e-3 * outcome.path.depth_mm)
    if best.parts.total > share:
        dhat = min(1.0, PART * share / max(best.parts.dhat, 1e-12))
        steps = math.ceil(best.parts.path / (PART * share) - 1e-9)
        used = Resolution(
            COARSE,
            min(max(dhat * dhat_m, SMALLEST_DHAT_M), dhat_m),
            min(max(steps, 1), MOST_STEPS),
        )
        left_dhat, left_path = used.dhat_m / dhat_m, 1 / used.steps
        before = before - (1 - left_dhat) * by_dhat - (1 - left_path) * by_path
        by_dhat, by_path = left_dhat * by_dhat, left_path * by_path
    shortfall, change = None, np.zeros_like(before)
    while best.parts.total > share:
        used = replace(used, mesh=used.mesh * FINER)
        shortfall = _reason_to_stop(best, used, share, clock() - started + predicted, budget_s)
        if shortfall is not None:
            break
        begun = clock()
        try:
            outcome = pressed(used)
        except SimulationError as error:
            shortfall = f"a finer press did not converge: {error}"
            break
        predicted = MESH_COST * (clock() - begun)
        now = _reading(outcome, seen)
        change, last_change = now - before, change
        by_mesh = _by_mesh(last_change, change)
        best = _found(outcome, used, by_mesh, by_dhat, by_path, PAIR_REST[kind])
        before = now
    refinement = Refinement(
        share, best.parts, best.used, best.height_m, count, clock() - started, shortfall
    )
    return refinement.stated_for(best.outcome), refinement


def _reason_to_stop(
    best: _Found, following: Resolution, share: float, end_s: float, budget_s: float
) -> str | None:
    if best.used.mesh >= 1 and best.parts.dhat + best.parts.path > share:
        return "neither a smaller dhat nor more steps are allowed"
    if following.mesh > FINEST * 1.001:
        return "no finer mesh is allowed"
    if end_s > budget_s:
        return f"the next press would end after about {end_s:.0f} s; the budget is {budget_s:g} s"
    return None


def _found(
    outcome: PressOutcome,
    used: Resolution,
    by_mesh: np.ndarray,
    by_dhat: np.ndarray,
    by_path: np.ndarray,
    rest: float,
) -> _Found:
    """Errors of a press by causes, each as in ``_reading``; ``rest`` of the force on the default's
    mesh are left over."""
    force = abs(_force_n(outcome))
    mesh, dhat, path = (float(abs(part[0])) / force for part in (by_mesh, by_dhat, by_path))
    heights = sum(_rms(part[1:]) for part in (by_mesh, by_dhat, by_path))
    return _Found(
        outcome,
        used,
        Parts(mesh + rest / used.mesh, dhat, path),
        heights + PAIR_HEIGHT_REST / used.mesh * 1e-3 * outcome.path.depth_mm,
    )


def _by_mesh(last_change: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Errors of the finest mesh as in ``_reading``, by how much smaller the change of the force is
    than the one before (Richardson); ``last_change`` is 0 where there was none.

    Forces that went down and come up again do not converge yet: under rims the two errors of a
    mesh, too stiff and too far from the rim, may just cancel. The last change says little then, and
    the force may be off by what second order leaves of the one before.
    """
    last, now = float(last_change[0]), float(change[0])
    if last * now > 0:
        share = 1 / max(last / now - 1, 1e-9)
        return float(np.clip(share, PAIR_SHARE, FIRST_ORDER_SHARE)) * change
    found = PAIR_SHARE * change
    found[0] = max(abs(found[0]), SECOND_ORDER_SHARE * abs(last))
    return found


def _force_n(outcome: PressOutcome) -> float:
    return float(outcome.steps[-1].wrench[2])


def _reading(outcome: PressOutcome, seen: np.ndarray) -> np.ndarray:
    """Force [N] and how far heights have moved [m], [1 + pixels of ``seen``]."""
    moved = outcome.height_m - outcome.rest_height_m
    return np.concatenate([[_force_n(outcome)], moved[seen]])


def _rms(heights_m: np.ndarray) -> float:
    """Root of the mean square, of pixels where all presses have gel."""
    known = heights_m[np.isfinite(heights_m)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan
