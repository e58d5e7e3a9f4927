# SPDX-License-Identifier: Apache-2.0
"""Where the indenter of a press goes, step by step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.bodies.material import MaxwellBranch
from taccel_lab.bodies.scene_description import LONGEST_HOLD_S
from taccel_lab.errors import InputError
from taccel_lab.guards import require_positive, require_range
from taccel_lab.typed import typed

SPEED_MM_S = 1.0
"""Speed of an indenter of which nothing is known: as by hand."""
HOLD_STEPS = 8
"""Steps of a hold; their ends lie evenly over the root of time, as a force falls fast at first."""
MAX_STEPS = 10_000
"""Longest path: a step length mistaken for another unit would keep a machine busy for days."""
TIME_SHARE = 0.004
"""Share of the force that steps in time may add by this rule; a press measures what they do."""
LEAST_STEPS = 2
"""Down, of gels that rub or relax."""
MOST_TIMES = 64
"""Steps over those of the path, at most."""
_EXACT = 4096
"""Steps that stand for none."""

Waypoint = tuple[float, tuple[float, float], float]
"""Depth [mm], shear [mm], twist [deg]."""
COMMAND = ("depth_mm", "shear_x_mm", "shear_y_mm", "turn_x_deg", "turn_y_deg", "turn_z_deg")
"""Columns of what is asked of a step: depth past first touch, motion along the face, rotation
vector. A roll moves the tool on besides (``rolled_mm``)."""


def rolled_mm(commands: np.ndarray, height_mm: np.ndarray) -> np.ndarray:
    """How far tools whose origins are ``height_mm`` [n] above the face have rolled on by their
    turns, [n, 2]: height times angle, as without sliding; ``commands`` is [n, 6]."""
    turn = np.radians(commands[:, 3:5])
    return height_mm[:, None] * np.column_stack([turn[:, 1], -turn[:, 0]])


@typed
@dataclass(frozen=True)
class PressPath:
    """Where the indenter goes: down, then sideways, about its vertical axis or rolling."""

    depth_mm: float
    """Depth past first touch."""
    shear_mm: tuple[float, float] = (0.0, 0.0)
    """Sideways motion at full depth, gel x and y."""
    twist_deg: float = 0.0
    """Turn about +z at full depth, right-handed in the gel frame."""
    step_mm: float = 0.2
    """Largest motion in one step."""
    step_deg: float = 2.0
    """Largest turn in one step."""
    back: bool = False
    """Whether the indenter then goes back the way it came, to first touch."""
    speed_mm_s: float = SPEED_MM_S
    """Speed of all motions [mm/s]; a turn by ``step_deg`` takes as long as ``step_mm``. Only of
    gels that relax."""
    hold_s: float = 0.0
    """How long the indenter then rests at full depth [s], before it goes back."""
    roll_deg: tuple[float, float] = (0.0, 0.0)
    """Turn about x and y at full depth, by which it moves on, see ``rolled_mm``; of touches of data
    sets alone, which go by ``commands``."""

    def __post_init__(self) -> None:
        require_positive("depth", self.depth_mm, "mm")
        require_range("depth", self.depth_mm, 0, 100, "mm")
        require_range("shear", self.shear_mm, -20, 20, "mm")
        require_range("twist", self.twist_deg, -180, 180, "deg")
        require_range("roll", self.roll_deg, -90, 90, "deg")
        require_range("speed", self.speed_mm_s, 1e-4, 1e3, "mm/s")
        require_range("hold", self.hold_s, 0, LONGEST_HOLD_S, "s")
        require_positive("step_mm", self.step_mm)
        require_positive("step_deg", self.step_deg)
        motion_mm = max(self.depth_mm, math.hypot(*self.shear_mm))
        least_mm, least_deg = motion_mm / MAX_STEPS, self._turn_deg / MAX_STEPS
        if self.step_mm < least_mm or self.step_deg < least_deg:
            raise InputError(
                f"step_mm {self.step_mm:g} and step_deg {self.step_deg:g} make more than "
                f"{MAX_STEPS} steps of this path; at least {least_mm:.3g} mm and {least_deg:.3g} "
                "deg are needed"
            )

    def with_steps(self, times: float) -> PressPath:
        """Divide the same path into ``times`` as many steps, 1 at least."""
        if times == 1:
            return self
        far = max(self.depth_mm, math.hypot(*self.shear_mm))
        down, turns = min(self.step_mm, far), min(self.step_deg, self._turn_deg or 1.0)
        return replace(self, step_mm=down / times, step_deg=turns / times)

    def bounded(self, branches: Sequence[MaxwellBranch], friction: float) -> PressPath:
        """Divide the path so finely that time adds ``TIME_SHARE`` to the force at most, and into
        ``LEAST_STEPS`` down; the path itself where nothing rubs or relaxes.

        In time a step is exact where stress grows evenly over it (``ipc.potentials.elements.
        maxwell``). Under a ball it does not: the contact grows, force as depth^1.5 (Hertz). What
        that leaves follows from the branches alone, without a gel. Under friction the first step
        lays down the whole contact at once; it takes two at least, so that one of half as many
        shows what they do.
        """
        if not branches and friction == 0:
            return self
        exact = self._overstress(_EXACT, branches)
        times = 1
        while times < MOST_TIMES:
            down, _ = self.with_steps(times).counts
            off = self._overstress(down, branches) - exact
            if down >= LEAST_STEPS and abs(off) <= TIME_SHARE * (1.0 + exact):
                break
            times *= 2
        return self.with_steps(times)

    def _overstress(self, count: int, branches: Sequence[MaxwellBranch]) -> float:
        """Force of the branches at full depth over that of the relaxed solid, in ``count`` even
        steps [Simo and Hughes 1998, 10.3]."""
        growth = np.diff((np.arange(count + 1) / count) ** 1.5)
        step_s = self.depth_mm / self.speed_mm_s / count
        total = 0.0
        for branch in branches:
            h = step_s / branch.time_s
            even = -math.expm1(-h) / h
            left = np.exp(-h * np.arange(count - 1, -1, -1.0))
            total += branch.relative_modulus * even * float(growth @ left)
        return total

    @property
    def _turn_deg(self) -> float:
        """Largest turn about any axis."""
        return max(abs(self.twist_deg), math.hypot(*self.roll_deg))

    @property
    def is_straight_down(self) -> bool:
        """Whether it ends at full depth as soon as it is there, right above where it began."""
        return not (self.counts[1] or self.back or self.hold_s > 0)

    @property
    def counts(self) -> tuple[int, int]:
        """Steps down, and aside."""
        aside = max(
            math.ceil(math.hypot(*self.shear_mm) / self.step_mm - 1e-9),
            math.ceil(self._turn_deg / self.step_deg - 1e-9),
            int(any((*self.shear_mm, *self.roll_deg, self.twist_deg))),
        )
        return max(1, math.ceil(self.depth_mm / self.step_mm - 1e-9)), aside

    def commands(self) -> np.ndarray:
        """Return where each step down and aside goes to, columns ``COMMAND``, [step, 6]."""
        down, aside = self.counts
        step = np.arange(1, down + aside + 1)
        deep, far = np.minimum(step / down, 1.0), np.maximum(step - down, 0) / max(aside, 1)
        turn = np.array([*self.roll_deg, self.twist_deg])
        return np.column_stack(
            [self.depth_mm * deep, np.outer(far, self.shear_mm), np.outer(far, turn)]
        )

    def way_there(self) -> list[Waypoint]:
        """Return the waypoints down and aside, before a hold."""
        rows = self.commands().tolist()
        return [(depth, (x, y), twist) for depth, x, y, *_, twist in rows]

    def waypoints(self) -> list[Waypoint]:
        """Depth [mm], shear [mm] and twist [deg] at the end of each step."""
        there = self.way_there()
        held = [there[-1]] * (HOLD_STEPS if self.hold_s > 0 else 0)
        back = [*reversed(there[:-1]), (0.0, (0.0, 0.0), 0.0)] if self.back else []
        return [*there, *held, *back]

    def durations_s(self) -> list[float]:
        """Return how long each step takes [s]."""
        at = (0.0, (0.0, 0.0), 0.0)
        held, found = 0, []
        for depth, shear, twist in self.waypoints():
            aside_mm = math.dist(shear, at[1])
            steps = max(
                math.hypot(depth - at[0], aside_mm) / self.step_mm,
                abs(twist - at[2]) / self.step_deg,
            )
            duration = steps * self.step_mm / self.speed_mm_s
            if (depth, shear, twist) == at:
                held += 1
                duration = self.hold_s * (held**2 - (held - 1) ** 2) / HOLD_STEPS**2
            found.append(duration)
            at = (depth, shear, twist)
        return found
