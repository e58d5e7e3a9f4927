# SPDX-License-Identifier: Apache-2.0
"""Numerical error of what a press feels beside its normal force: sideways force and moments.

They are found by the press itself and the coarser one beside it, like the normal force's error, but
in newtons and newton metres: a sideways force is a small difference of large ones, and may be 0.
**Steps** matter most where a gel sticks to a tool that comes down; all that they add is stated and
half as much again. Under rims the whole change of **mesh** is stated; beside balls the coarser mesh
has lost a layer and says nothing. A tool without **friction** feels no sideways force and no moment
about its axis on a flat pad, as no place on it is better than another: what is found there is all
error. ``Left`` is what presses need beside that, see docs/evidence/verification.md, Presses by
default.

What steps and mesh add to the normal force is taken off what slips, which follows that force, and
not off what sticks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from taccel_lab.presses.outcome import PressOutcome

FLAT = 1e-6
"""Largest lean of the normals of a flat pad's face at rest, as 1 less their z."""
STEPS_STATED = 1.5
"""Stated error of steps, over what they add."""


class AsideError(NamedTuple):
    """Errors of the last wrench of a press, and what is taken off it."""

    factor: float
    """The stated sideways force over the solved one, and the moment about z [1]."""
    shear_n: float
    """Error of the sideways force [N]."""
    moment_nm: tuple[float, float, float]
    """Errors of the moments about the gel's origin [N m]."""

    @classmethod
    def by_rule(cls, outcome: PressOutcome, share: float) -> AsideError:
        """Errors of a press with nothing beside it: a share of all that presses."""
        radius, (x, y) = _radius_m(outcome), map(float, np.abs(outcome.indenter_pose[:2]))
        force = share * (math.hypot(*outcome.wrench[:2]) + abs(outcome.largest_n))
        return cls(
            1.0, force, (force * (y + radius), force * (x + radius), force * (x + y + radius))
        )


class Left(NamedTuple):
    """What is left of a grade beside mesh and steps."""

    shear: float
    """Sideways force over the normal one [1]."""
    moment: float
    """Moments over the normal force times the contact's radius [1]."""
    of_shear: float = 0.01
    """Share of the sideways force."""
    of_twist: float = 0.01
    """Share of the moment about the tool's axis."""


LEFT_OF_BALLS, LEFT_OF_RIMS = Left(0.001, 0.004), Left(0.003, 0.005, of_twist=0.03)
LEFT_BY_FRICTION = 0.004
"""What balls add to both by the coefficient of friction."""


def aside_error(
    best: PressOutcome,
    below: PressOutcome,
    friction: float,
    is_ball: bool,
    factor: float,
    share: float,
    level: int,
    finer: float,
) -> AsideError:
    """Errors of the sideways force and the moments of a press.

    Args:
        best: The press.
        below: The coarser press beside it, which knows what steps add, see
            ``PressOutcome.steps_wrench``; of a higher level the one below.
        friction: Coefficient.
        is_ball: Whether the tool is one.
        factor: Stated normal force over the solved one.
        share: Error of the stated normal force, over it.
        level: Of the press.
        finer: How much less is left of the normal force than of the default's.
    """
    normal, radius = abs(best.largest_n), _radius_m(best)
    here, there = _about_tool(best, best.wrench), _about_tool(below, below.wrench)
    added = below.steps_wrench
    steps = np.zeros(6) if added is None else _about_tool(below, added) / 2**level
    left = LEFT_OF_BALLS if is_ball else LEFT_OF_RIMS
    rubbed = LEFT_BY_FRICTION * friction if is_ball else 0.0
    # Of sideways force, of bending and of twist.
    arms = np.array([1.0, radius, radius])
    error = (np.array([left.shear, left.moment, left.moment]) + rubbed) / finer * normal * arms
    error += STEPS_STATED * _parts(steps)
    error += np.array([left.of_shear, share, left.of_twist]) * _parts(here)
    if not is_ball:
        error += _parts(there - here)
    if friction == 0 and not is_ball and _is_flat(best):
        error += _parts(here) * [1.0, 0.0, 1.0]
    shear, bend, twist = map(float, error)
    x, y = map(float, np.abs(best.indenter_pose[:2]))
    force = share * normal
    moment = bend + y * force, bend + x * force, twist + math.hypot(x, y) * shear
    slips = 1.0
    if friction > 0 and normal > 0:
        loaded = math.hypot(*here[:2], here[5] / radius)
        slips = min(loaded / (friction * normal), 1.0)
    return AsideError(1.0 + slips * (factor - 1.0), shear, moment)


def _about_tool(outcome: PressOutcome, wrench: np.ndarray) -> np.ndarray:
    """A wrench about the gel's origin as one about the tool's axis, on the gel's plane, [6]."""
    x, y = outcome.indenter_pose[:2]
    fx, fy, fz = wrench[:3]
    return wrench - [0.0, 0.0, 0.0, y * fz, -x * fz, x * fy - y * fx]


def _parts(wrench: np.ndarray) -> np.ndarray:
    """Sizes of sideways force, moment about axes in the plane, and about z, [3]."""
    return np.array([math.hypot(*wrench[:2]), math.hypot(*wrench[3:5]), abs(wrench[5])])


def _radius_m(outcome: PressOutcome) -> float:
    """Radius of gyration of the contact's forces about their middle [m], the press's depth at
    least."""
    force = np.linalg.norm(outcome.contact_forces_n, axis=1)
    least = 1e-3 * outcome.path.depth_mm
    if not force.any():
        return least
    away = outcome.positions_m - np.average(outcome.positions_m, axis=0, weights=force)
    return max(math.sqrt(np.average((away**2).sum(axis=1), weights=force)), least)


def _is_flat(outcome: PressOutcome) -> bool:
    """Whether the pad's face at rest is a plane across z."""
    return bool(np.nanmin(outcome.rest_normals[..., 2]) > 1.0 - FLAT)
