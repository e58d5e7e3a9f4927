# SPDX-License-Identifier: Apache-2.0
"""A press that measures its numerical error: coarser ones stand beside it. And how far its heights
and image may be off, by all that is known.

Its parts are taken apart. Of **steps**, in path and time, a coarser mesh shows as well what half as
many add: that is of first order, and as much is left, so it is taken off. The **contact range**
follows the depth (``PressPhysics.of_press``). Of the **mesh** the change from one with 0.7 times
the elements along every side says what it is worth: under rims errors are of about first order, and
half of a small change is taken off and half is stated; a large one is no series yet, so that
nothing is taken off and all of it is stated. Under balls it says little, as the coarser mesh has
lost a layer and the press itself is within half a per cent: nothing is taken off. What is left is
what an independent axisymmetric code and meshes of twice the elements show
(docs/evidence/verification.md, Presses by default). ``--accuracy 3%`` goes up level by level, where
each press is the one beside the next: elements are 2^0.5 times as many along every side, ``dhat``
is halved, and so are the steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.presses.aside_error import AsideError, aside_error
from taccel_lab.presses.outcome import PressOutcome
from taccel_lab.presses.physics import (
    GAP_SHARE,
    Accuracy,
    PressPhysics,
    Shares,
    expected_error,
)
from taccel_lab.presses.resolution import AS_IT_IS, BESIDE, FINER, Resolution
from taccel_lab.scene import Ball, Element, TriangleMesh

if TYPE_CHECKING:
    from taccel_lab.profile import Provenance

MOST_LEVELS = 4
"""Levels above that of the options."""
TAKEN_OFF = STATED = 0.5
"""Parts of the change of mesh from the level below, of tools that may have rims."""
SMALL_CHANGE = 0.06
"""Change of mesh up to which it is believed to be one of a series, of tools that may have rims."""
LARGE_CHANGE = 0.12
"""The same of balls: a coarser mesh that is sound changes the force by 9 % at most."""
STEPS_STATED = 0.5
"""Part of what steps add that is stated."""
LEFT = {
    Accuracy.FAST: Shares(0.0075, 0.08),
    Accuracy.DEFAULT: Shares(0.0075, 0.024),
    Accuracy.REFERENCE: Shares(0.003, 0.01),
}
"""Shares of the force, beside that: what 19 of 20 presses of the battery need."""
LEFT_BY_FRICTION = 0.005
"""The same of balls, by the coefficient of friction."""
LEFT_WHERE_STUCK = 0.6
"""Part of what is left of tools with rims under friction, where the gel does not slip past the
rim."""
SLID, MOST_SLID = 0.2, 0.13
"""Share of the force by how far a rim has slid from the rows of nodes that it came down on, over
the contact's radius; and that at most: a punch of 2 mm, 0.3 mm deep, is 3, 5 and 10 % off after
0.4, 0.6 and 1 mm."""
LEFT_OF_DEPTH = 0.002
"""The same of the heights, over the depth; beside it the whole change is stated."""
UNKNOWN_GUARD = 0.01
"""Stands for a share of the guard that cannot be measured, where the gel is about to buckle: twice
the largest of seven pins and edges."""
SECOND_ORDER = 0.5
"""What second order leaves of a change on the next level."""
SLOWEST = 0.75
"""Largest fall of changes from level to level that is believed: first order halves them."""
UPRIGHT = 0.5
"""Least z of the normals of pixels whose heights are compared: farther down on a dome's side
heights are differences of where a facet happens to end."""

_AROUND = 0.05
"""Part of the depth from which on a pixel counts as pressed."""
_WHITE = 255.0


@dataclass(frozen=True)
class NumericalError:
    """What a press states of its mesh, contact range and steps."""

    factor: float
    """The stated force over the solved one [1]."""
    share: float
    """Numerical error of the stated force, over it [1]."""
    height_error_m: float
    """Error of the heights, root mean square [m]."""
    guard_share: float
    """Part of ``share`` that depends on the guard against inside-out tets [1]."""
    changes: tuple[float, ...]
    """Solved forces less that of the finest level, over it, coarsest first [1]."""
    steps_share: float
    """Part of the solved force that the length of its steps adds [1]."""
    level: int
    """Level of the press; 0 is that of the options."""
    presses: int
    aside: AsideError
    """The same of the sideways force and the moments."""
    asked: float | None = None
    """Relative error that was asked for [1]; None of a grade."""
    shortfall: str | None = None
    """Why the error is not measured, or larger than asked for, in a sentence."""

    def figures(self) -> dict[str, Any]:
        """Figures as JSON."""
        return asdict(self) | {"aside": self.aside._asdict()}

    def words(self) -> str:
        """What the error rests on, in a sentence."""
        said = f"{100 * self.share:.2g} % of the force, by {self.presses} presses"
        if self.level:
            said += f", the finest {FINER**self.level:.2g} times as fine as the default"
        if self.guard_share > 0.01:
            said += (
                f"; the guard against inverted elements carries {100 * self.guard_share:.2g} %: "
                "the gel is pressed past what its mesh resolves"
            )
        if self.shortfall is None:
            return said
        if self.asked is None:
            return f"{said}; {self.shortfall}"
        return f"{said}; {100 * self.asked:g} % was not reached: {self.shortfall}"

    def stated_for(self, outcome: PressOutcome) -> PressOutcome:
        """A press of this resolution with what mesh, contact range and steps add taken off all its
        loads, and with the errors that it states. What states it kept are as solved."""
        factor, aside = self.factor, self.aside.factor
        loads = np.array([aside, aside, factor, factor, factor, aside])
        steps = [replace(step, wrench=loads * step.wrench) for step in outcome.steps]
        return replace(
            outcome,
            steps=steps,
            contact_forces_n=loads[:3] * outcome.contact_forces_n,
            contact_pressures_pa=factor * outcome.contact_pressures_pa,
            von_mises_pa=factor * outcome.von_mises_pa,
            # After a way back hardly anything is left of what the error was found of.
            force_error_n=self.share * abs(factor * outcome.largest_n),
            height_error_m=self.height_error_m,
            shear_error_n=self.aside.shear_n,
            moment_error_nm=self.aside.moment_nm,
        )


@dataclass(frozen=True)
class MeasuredPress:
    """A press, as it was solved, and what its error rests on."""

    outcome: PressOutcome
    error: NumericalError
    below: PressOutcome | None
    """Outcome of the level below; None where it failed."""


PressAt = Callable[[Resolution], PressOutcome]
"""A press of some resolution; SimulationError where it does not converge."""


def measured_press(
    press: PressAt,
    physics: PressPhysics,
    shape: Ball | TriangleMesh,
    *,
    friction: float,
    remembers: bool,
    beside_edge: bool = False,
    asked: float | None = None,
    levels: int = 0,
) -> MeasuredPress:
    """Press, and press beside it, until the numerical error of the force is small enough.

    Args:
        press: Does a press.
        physics: Of level 0.
        shape: What presses.
        friction: Coefficient between it and the gel.
        remembers: Whether the gel's state depends on the path: it rubs or relaxes.
        beside_edge: Whether a ball touches so near to the pad's edge that its mesh is no usual one.
        asked: Relative error of the force [1]; None for level 0 as it is.
        levels: Finest level, 4 at most: each takes about four times as long as the one below.

    Returns:
        The finest press. SimulationError and InputError as of the press at level 0; where another
        fails, the error says so.
    """
    best, level = press(AS_IT_IS), 0
    found = _by_rule(best, physics, shape, asked)
    if physics.element is Element.LINEAR:
        reason = "linear elements are too stiff on any mesh, so that this is a rule of thumb"
        return MeasuredPress(best, replace(found, shortfall=reason), None)
    try:
        below = press(BESIDE)
    except (SimulationError, InputError) as error:
        reason = f"the coarser press beside it failed ({error}), so that this is a rule of thumb"
        return MeasuredPress(best, replace(found, shortfall=reason), None)
    pressed, last = [below, best], 0.0
    shortfall: str | None = None
    while True:
        found, last = _measured(pressed, physics, shape, friction, beside_edge, last, asked)
        if asked is None or found.share <= asked:
            break
        if level >= min(levels, MOST_LEVELS):
            shortfall = f"{level} finer presses were allowed"
            if level < MOST_LEVELS:
                shortfall += f"; --levels {level + 1} takes about four times as long"
            break
        try:
            best = press(Resolution.of(level + 1, remembers))
        except (SimulationError, InputError) as error:
            shortfall = f"a finer press failed: {error}"
            break
        level += 1
        pressed.append(best)
    return MeasuredPress(best, replace(found, shortfall=shortfall), pressed[-2])


def _by_rule(
    outcome: PressOutcome, physics: PressPhysics, shape: Ball | TriangleMesh, asked: float | None
) -> NumericalError:
    depth_m, guard = 1e-3 * outcome.path.depth_mm, _guard_share(outcome)
    rule = expected_error(physics, shape, np.ones(1), np.full(1, depth_m))
    share = float(rule.force_n[0]) + guard
    aside = AsideError.by_rule(outcome, share)
    heights = float(rule.height_m[0])
    return NumericalError(1.0, share, heights, guard, (0.0,), 0.0, 0, 1, aside, asked)


def _guard_share(outcome: PressOutcome) -> float:
    return UNKNOWN_GUARD if math.isnan(outcome.guard_share) else outcome.guard_share


def _measured(
    pressed: list[PressOutcome],
    physics: PressPhysics,
    shape: Ball | TriangleMesh,
    friction: float,
    beside_edge: bool,
    last: float,
    asked: float | None,
) -> tuple[NumericalError, float]:
    """The error of the last of these presses, coarsest first, and its change by the mesh.

    Forces that went down and come up again (``last``: the change before) do not converge yet: under
    rims the two errors of a mesh, too stiff and too far from the rim, may just cancel. The force
    may be off by what second order leaves of the change before.
    """
    below, best = pressed[-2:]
    guard, level, solved = _guard_share(best), len(pressed) - 2, best.largest_n
    changes = tuple(one.largest_n / solved - 1 if solved else 0.0 for one in pressed)
    steps = (pressed[0].steps_share or 0.0) / 2**level
    # The level below has steps twice as long, but for the first, which has the same.
    change = changes[-2] - (steps if level else 0.0)
    is_ball = isinstance(shape, Ball)
    believed = abs(change) <= (LARGE_CHANGE if is_ball else SMALL_CHANGE)
    doubt = abs(change)
    if change * last < 0:
        doubt = max(doubt, SECOND_ORDER * abs(last))
    elif last:
        # Changes that fall by r leave r / (1 - r) of the last (Richardson), of which half is off.
        falls = min(change / last, SLOWEST)
        doubt *= max(1.0, 2 * falls / (1 - falls) - 1)
    # Beside a ball the first mesh has lost a layer, and its change is none of a series.
    says_something = level > 0 or beside_edge or not is_ball
    off, stated = 0.0, doubt
    if believed:
        off = 0.0 if is_ball else TAKEN_OFF * change
        stated = STATED * doubt if says_something else 0.0
    factor = 1.0 - off - steps
    left = LEFT[physics.accuracy].of(shape)
    slid = 0.0
    if is_ball:
        left += LEFT_BY_FRICTION * friction
    elif friction > 0:
        left, slid = LEFT_WHERE_STUCK * left, slid_share(best)
    left = left / FINER**level + slid
    gap = GAP_SHARE * STATED * best.physics.dhat_m / (1e-3 * best.path.depth_mm)
    share = (stated + STEPS_STATED * abs(steps) + left + gap) / abs(factor) + guard
    moved = (best.height_m - best.rest_height_m) - (below.height_m - below.rest_height_m)
    height_m = known_rms(moved[best.normals[..., 2] > UPRIGHT])
    height_m += LEFT_OF_DEPTH / FINER**level * 1e-3 * best.path.depth_mm
    # Of the press below the steps are known; level by level they are half as long.
    beside = replace(below, steps_wrench=pressed[0].steps_wrench)
    finer = FINER**level * LEFT[Accuracy.DEFAULT].of(shape) / LEFT[physics.accuracy].of(shape)
    aside = aside_error(best, beside, friction, is_ball, factor, share, level, finer)
    error = NumericalError(
        factor, share, height_m, guard, changes, steps, level, len(pressed), aside, asked
    )
    return error, change if says_something else 0.0


def slid_share(outcome: PressOutcome) -> float:
    """Share of the force of a tool with rims that may be off since these have slid from the rows of
    nodes that were drawn for them."""
    last = outcome.steps[-1]
    force = np.linalg.norm(outcome.contact_forces_n, axis=1)
    if not force.any() or (last.shear_mm == (0.0, 0.0) and last.twist_deg == 0.0):
        return 0.0
    touched = force > 0
    rest, now = outcome.mesh.nodes_m[touched, :2], outcome.positions_m[touched, :2]
    origin = outcome.indenter_pose[:2]
    angle = math.radians(last.twist_deg)
    c, s = math.cos(angle), math.sin(angle)
    # Where each point of the tool that now touches a node was above the gel at rest.
    came = (now - origin) @ [[c, -s], [s, c]] + origin - 1e-3 * np.asarray(last.shear_mm)
    slid = float(np.average(np.linalg.norm(came - rest, axis=1), weights=force[touched]))
    return min(SLID * slid / max(outcome.contact_radius_m, 1e-9), MOST_SLID)


@dataclass(frozen=True)
class SignalError:
    """Root mean square error over the pressed pixels, in the signal's unit."""

    numerical: float
    """Error by mesh, contact range and steps."""
    total: float
    """Error with a depth and place that were read, or a depth that a force leads to, and with the
    colours' own error."""


def height_error_mm(
    outcome: PressOutcome, depth_sigma_mm: float, place_sigma_px: tuple[float, float]
) -> SignalError:
    """Error of the heights [mm], with standard deviations of a depth [mm] and of a place's column
    and row [px] that were read."""
    numerical, moved = (
        1e3 * outcome.height_error_m,
        1e3 * (outcome.rest_height_m - outcome.height_m),
    )
    read = _read_error(outcome, moved, depth_sigma_mm, place_sigma_px)
    return SignalError(numerical, math.hypot(numerical, read))


def image_error_levels(
    outcome: PressOutcome,
    rgb: np.ndarray,
    beside_rgb: np.ndarray,
    background_rgb: np.ndarray,
    colours: Provenance,
    depth_sigma_mm: float,
    place_sigma_px: tuple[float, float],
) -> SignalError:
    """Error of an image in a profile's colours [levels of 255].

    Args:
        outcome: The press.
        rgb: Its image, levels, [height_px, width_px, 3].
        beside_rgb: That of the coarser press beside it.
        background_rgb: The untouched sensor.
        colours: Of the colour model: the held-out peak signal-to-noise ratio is its error.
        depth_sigma_mm: Standard deviation of a depth that was read [mm].
        place_sigma_px: The same of a place's column and row [px].
    """
    where = _pressed(outcome)
    numerical = known_rms((rgb - beside_rgb)[where])
    read = _read_error(outcome, rgb - background_rgb, depth_sigma_mm, place_sigma_px)
    psnr_db = colours.residuals.get("heldout_crop_psnr_db")
    seen = 0.0 if psnr_db is None else _WHITE * 10 ** (-psnr_db / 20)
    return SignalError(numerical, math.hypot(numerical, read, seen))


def _read_error(
    outcome: PressOutcome,
    signal: np.ndarray,
    depth_sigma_mm: float,
    place_sigma_px: tuple[float, float],
) -> float:
    """What a signal [height_px, width_px, ...] of the pressed pixels, in proportion to the depth,
    changes by two standard deviations of depth and place, root mean square."""
    where = _pressed(outcome)
    across, down = (known_rms(np.gradient(signal, axis=axis)[where]) for axis in (1, 0))
    column, row = place_sigma_px
    depth = known_rms(signal[where]) * depth_sigma_mm / outcome.path.depth_mm
    return 2 * math.hypot(depth, across * column, down * row)


def _pressed(outcome: PressOutcome) -> np.ndarray:
    """Pixels that the press moved, bool, [height_px, width_px]."""
    moved = outcome.rest_height_m - outcome.height_m
    return np.nan_to_num(np.abs(moved)) > _AROUND * 1e-3 * outcome.path.depth_mm


def known_rms(values: np.ndarray) -> float:
    """Root of the mean square of what is finite; 0 of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
