# SPDX-License-Identifier: Apache-2.0
"""Interval of a press's force, by all that is known to be uncertain.

Each cause gives factors of the force at the ends of its 95 % interval; as independent causes they
are put together by the squares of their logarithms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.profile.assumed import modulus_interval_pa, poisson_prior, thickness_interval_mm
from taccel_lab.profile.measured_range import measured_range, poisson_interval
from taccel_lab.scene import Ball

if TYPE_CHECKING:
    from taccel_lab.bodies.material import MaxwellBranch
    from taccel_lab.presses.indenter import Indenter
    from taccel_lab.presses.outcome import PressOutcome
    from taccel_lab.profile import SensorProfile
    from taccel_lab.profile.schema import BranchEntry

    Branch = MaxwellBranch | BranchEntry

FRICTION_SHARE = 0.13
"""Share of the normal force that depends on a coefficient which nobody measured. It is the largest
of balls, a punch and an edge in pads of 1 to 6 mm, without friction beside 0.3. A 4 mm ball 0.3 mm
deep in 1 mm of gel has it."""
SLOWER, FASTER = 0.1, 10.0
"""Speeds that nobody stated, over the one that was pressed with."""
ROUGHER = 0.5
"""What a coefficient of 1 adds over what one of 0 takes: 0.4 to 0.57 of those presses."""


_CELLS = 400


@dataclass(frozen=True)
class Cause:
    """What one uncertain quantity does to a force."""

    name: str
    low: float
    """Factor of the force at the lower end [1], at most 1."""
    high: float


@dataclass(frozen=True)
class ForceInterval:
    """95 % interval of a force, and what it is made of."""

    low_n: float
    high_n: float
    causes: tuple[Cause, ...]

    @classmethod
    def of(
        cls, force_n: float, causes: tuple[Cause, ...], numerical_n: float = 0.0
    ) -> ForceInterval:
        """Interval of a force [N] with independent causes. A numerical error [N] that is larger
        than the force, as after a way back, is no factor of it, and is added."""
        low = math.exp(-math.hypot(*(_log(each.low) for each in causes)))
        high = math.exp(math.hypot(*(_log(each.high) for each in causes)))
        ends = sorted((low * force_n, high * force_n))
        apart = numerical_n if numerical_n > abs(force_n) else 0.0
        return cls(ends[0] - apart, ends[1] + apart, causes)

    def ranked(self) -> list[Cause]:
        """Causes, the largest first."""
        return sorted(self.causes, key=lambda each: -max(_log(each.low), _log(each.high)))

    def words(self) -> str:
        """Interval and largest causes, for people."""
        said = [
            f"{each.name} {_ends(each)}"
            for each in self.ranked()
            if max(_log(each.low), _log(each.high)) > 1e-3
        ]
        return f"95 % interval: {self.low_n:.3g} to {self.high_n:.3g} N ({', '.join(said)})"


def _ends(cause: Cause) -> str:
    if cause.high >= 1.5:
        return f"x {cause.low:.2g} to {cause.high:.2g}"
    return f"{100 * (cause.low - 1):+.2g} to {100 * (cause.high - 1):+.2g} %"


def _log(factor: float) -> float:
    """Size of a factor's logarithm; factors of 0 count as a millionth."""
    return abs(math.log(max(factor, 1e-6)))


def force_causes(
    profile: SensorProfile,
    indenter: Indenter,
    outcome: PressOutcome,
    friction: float | None,
    slippery: float | None = None,
    depth_sigma_mm: float = 0.0,
    is_timed: bool = True,
) -> tuple[Cause, ...]:
    """What makes the force of a press uncertain.

    Args:
        profile: Of the sensor; ``profile.assumed`` has priors for what it does not state.
        indenter: What presses.
        outcome: The press, with its numerical error.
        friction: The coefficient that a person chose; None for the profile's.
        slippery: Force without friction over that with it, where it was pressed.
        depth_sigma_mm: Standard deviation of a depth that was read [mm].
        is_timed: Whether a person said how fast the tool was.
    """
    found: list[Cause] = []
    if math.isfinite(outcome.force_error_n) and outcome.force_n:
        share = outcome.force_error_n / abs(outcome.force_n)
        if share <= 1.0:
            found.append(Cause("numerical", 1.0 - share, 1.0 + share))
    material = profile.material
    # Every stress of a gel grows as its moduli do.
    low_pa, high_pa = modulus_interval_pa(material)
    pa = material.young_modulus_pa
    found.append(Cause("Young's modulus", low_pa / pa, high_pa / pa))
    nu, mm = material.poisson_ratio, profile.gel.thickness_mm
    thin, thick = thickness_interval_mm(profile.gel)
    force = _Layer(indenter, outcome)
    rest = force.at(mm, nu)
    found.append(Cause("thickness", force.at(thick, nu) / rest, force.at(thin, nu) / rest))
    if (ends := poisson_interval(profile) or poisson_prior(material)) is not None:
        found.append(Cause("Poisson's ratio", *sorted(force.at(mm, end) / rest for end in ends)))
    if friction is None:
        less = FRICTION_SHARE if slippery is None else max(1.0 - slippery, 0.0)
        down, up = _friction_parts(profile)
        found.append(Cause("friction", 1.0 - down * less, 1.0 + up * ROUGHER * less))
    if material.branches and not is_timed and not outcome.path.back:
        factor = partial(relaxing_factor, material.branches, outcome)
        ends = (factor(faster=times) / factor() for times in (SLOWER, FASTER))
        found.append(Cause("speed", *ends))
    if depth_sigma_mm > 0:
        power = force_power(outcome)
        off = 2 * depth_sigma_mm / outcome.path.depth_mm
        found.append(Cause("depth", max(1.0 - off, 0.0) ** power, (1.0 + off) ** power))
    return tuple(found)


def _friction_parts(profile: SensorProfile) -> tuple[float, float]:
    """Parts of the ways from the profile's coefficient to 0 and to 1 that it may be off by."""
    known = measured_range(profile, "friction_coefficient")
    if known is None:
        return 1.0, 1.0
    value = profile.material.friction_coefficient
    down = (value - known.low) / value if value > 0 else 0.0
    up = (known.high - value) / (1.0 - value) if value < 1 else 0.0
    return min(down, 1.0), min(up, 1.0)


def force_power(outcome: PressOutcome) -> float:
    """Power of the depth that the force grows as at full depth: of the last two steps down, or
    1.5 (Hertz) of one."""
    down = [
        (step.depth_mm, float(step.wrench[2]))
        for step in outcome.steps[: len(outcome.path.way_there())]
        if step.shear_mm == (0.0, 0.0) and step.twist_deg == 0.0 and step.wrench[2] > 0
    ]
    if len(down) < 2:
        return 1.5
    (d0, f0), (d1, f1) = down[-2:]
    return max(math.log(f1 / f0) / math.log(d1 / d0), 0.5)


def relaxing_factor(
    branches: Sequence[Branch], outcome: PressOutcome, faster: float = 1.0
) -> float:
    """Force of a gel that relaxes over that of the relaxed gel, ``faster`` times as fast.

    As the force grows by a power p of the depth, and the depth evenly, a branch adds g p int_0^1
    s^(p - 1) exp(-(T (1 - s) + hold) / tau) ds after a time T down [the hereditary integral: Lee
    and Radok, Journal of Applied Mechanics 27 (1960)].
    """
    path = outcome.path
    down_s, power = path.depth_mm / (path.speed_mm_s * faster), force_power(outcome)
    # Even in s^p, by the middles of cells.
    share = ((np.arange(_CELLS) + 0.5) / _CELLS) ** (1.0 / power)
    after_s = down_s * (1.0 - share) + path.hold_s
    return 1.0 + sum(
        each.relative_modulus * float(np.exp(-after_s / each.time_s).mean()) for each in branches
    )


class _Layer:
    """Force on a bonded layer of a tool that touches it as the press did: the ball itself, or a
    punch of the contact's radius."""

    def __init__(self, indenter: Indenter, outcome: PressOutcome) -> None:
        self._depth_mm = np.array([outcome.path.depth_mm])
        shape = indenter.shape
        ball_mm = 1e3 * shape.radius_m if isinstance(shape, Ball) else 0.0
        self._ball = ball_mm > 2 * outcome.path.depth_mm
        self._radius_mm = ball_mm if self._ball else max(1e3 * outcome.contact_radius_m, 0.05)

    def at(self, thickness_mm: float, poisson_ratio: float) -> float:
        """Force for a modulus of 1 Pa [N]."""
        kind = "sphere" if self._ball else "cylinder"
        found = layer_force_n(kind, self._depth_mm, self._radius_mm, thickness_mm, poisson_ratio)
        return float(np.ravel(found)[0])
