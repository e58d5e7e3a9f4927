# SPDX-License-Identifier: Apache-2.0
"""Ranges of the parameters that episodes draw: of a task's file, of a sensor, or given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.bodies.bodies import combined_friction
from taccel_lab.errors import InputError
from taccel_lab.guards import unknown
from taccel_lab.scene import Scene

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile
    from taccel_lab.tasks.parameters import Randomised

Given = Mapping[str, tuple[float, float]]
"""Ranges by what is drawn, in place of others."""


@dataclass(frozen=True)
class DrawnRange:
    """A parameter of bodies that each episode draws anew, evenly; see ``tasks`` ``Randomised``."""

    what: str
    of: tuple[tuple[str, ...], ...]
    low: float
    high: float


def ranges_of(listed: Sequence[Randomised], given: Given) -> tuple[DrawnRange, ...]:
    """What a task's file lists, with the ranges that are given in place of its own.

    Raises InputError for a range of what is not listed, or whose ends are the wrong way round.
    """
    check_given(given, {item.what for item in listed})
    return tuple(
        DrawnRange(item.what, tuple(item.of), *given.get(item.what, (item.low, item.high)))
        for item in listed
    )


def sensor_ranges(
    listed: Sequence[Randomised],
    sensor: SensorProfile,
    gels: Sequence[str],
    scene: Scene,
    given: Given,
) -> tuple[DrawnRange, ...]:
    """Ranges as of ``ranges_of``, where gels are those of a sensor: their modulus, Poisson's ratio
    and friction by what its profile states.

    Friction of a pair follows from that of the gel as the scene's does. Poisson's ratio is drawn
    where the profile states its spread or a range is given, whether it is listed or not.

    Raises:
        InputError: The profile states no spread of what is listed of its gels, and no range is
            given; or as of ``ranges_of``.
    """
    # Profiles need pydantic, which the machines of a cluster may lack.
    from taccel_lab.profile.measured_range import measured_ranges

    check_given(given, {item.what for item in listed} | {"poisson_ratio", "young_modulus_pa"})
    stated = measured_ranges(sensor)
    bodies = {body.name: body for body in scene.bodies}

    def ends_of(name: str, what: str) -> tuple[float, float]:
        if what in given:
            return given[what]
        if name not in stated:
            raise _unstated(sensor, what)
        return stated[name].low, stated[name].high

    found = []
    for item in listed:
        of_gels = [names for names in item.of if set(names) & set(gels)]
        others = tuple(names for names in item.of if names not in of_gels)
        if others:
            found.append(
                DrawnRange(item.what, others, *given.get(item.what, (item.low, item.high)))
            )
        for names in of_gels if item.what == "friction" else ():
            low, high = ends_of("friction_coefficient", "friction")
            if "friction" not in given:
                gel, other = sorted(names, key=lambda name: name not in gels)
                low, high = (
                    combined_friction(replace(bodies[gel], friction_coefficient=end), bodies[other])
                    for end in (low, high)
                )
            found.append(DrawnRange("friction", (names,), low, high))
    for what in ("young_modulus_pa", "poisson_ratio"):
        if what in given or what in stated or any(item.what == what for item in listed):
            low, high = ends_of(what, what)
            found.append(DrawnRange(what, tuple((gel,) for gel in gels), low, high))
    return tuple(found)


def check_given(given: Given, known: set[str]) -> None:
    """Refuse ranges of what is not drawn, and those whose ends are the wrong way round."""
    if not isinstance(given, Mapping):
        raise InputError(f"randomised is True, False or ranges by what is drawn, got {given!r}")
    for what, ends in given.items():
        if what not in known:
            raise InputError(
                f"randomised gives a range of {what!r}, which episodes of this task do not draw"
                f"{unknown(what, sorted(known))}"
            )
        if np.shape(ends) != (2,):
            raise InputError(f"range of {what} must be (low, high), got {ends!r}")
        low, high = ends
        if not low <= high:
            raise InputError(f"range of {what} must be low <= high, got {low:g} and {high:g}")


def _unstated(sensor: SensorProfile, what: str) -> InputError:
    kind = sensor.material.provenance.kind
    return InputError(
        f"sensor {sensor.sensor.name!r} states no measured spread of {what}: its material is "
        f"{kind}, and its block perturbation has none between units either. Give a range yourself, "
        f"randomised={{{what!r}: (low, high)}}, or measure it with taccel-lab calibrate material "
        "or calibrate background"
    )
