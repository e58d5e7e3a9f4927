# SPDX-License-Identifier: Apache-2.0
"""How many steps a press takes whose end depends on its path.

In time a step is exact where stress grows evenly over it (``ipc.potentials.elements.maxwell``).
Under a ball it does not: the contact grows, force as depth^1.5 (Hertz). What that leaves follows
from the branches alone, without a gel. Under friction the first step lays down the whole contact at
once; it takes two at least, so that one of half as many shows what they do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from taccel_lab.bodies.maxwell import MaxwellBranch
from taccel_lab.presses.press_path import PressPath

TIME_SHARE = 0.004
"""Of the force, that steps in time may add by this rule; a press measures what they do."""
LEAST_STEPS = 2
"""Down, of gels that rub or relax."""
MOST_TIMES = 64
"""Steps over those of the path, at most."""
_EXACT = 4096
"""Steps that stand for none."""


def bounded_path(path: PressPath, branches: Sequence[MaxwellBranch], friction: float) -> PressPath:
    """The path in so many steps that time adds ``TIME_SHARE`` to the force at most, and in
    ``LEAST_STEPS`` down; the path itself where nothing rubs or relaxes."""
    if not branches and friction == 0:
        return path
    exact = _overstress(_EXACT, path, branches)
    times = 1
    while times < MOST_TIMES:
        down = _steps_down(path.with_steps(times))
        off = _overstress(down, path, branches) - exact
        if down >= LEAST_STEPS and abs(off) <= TIME_SHARE * (1.0 + exact):
            break
        times *= 2
    return path.with_steps(times)


def _steps_down(path: PressPath) -> int:
    return sum(shear == (0.0, 0.0) and twist == 0.0 for _, shear, twist in path.way_there())


def _overstress(count: int, path: PressPath, branches: Sequence[MaxwellBranch]) -> float:
    """Force of the branches at full depth over that of the relaxed solid, in ``count`` even steps
    [Simo and Hughes 1998, 10.3]."""
    growth = np.diff((np.arange(count + 1) / count) ** 1.5)
    step_s = path.depth_mm / path.speed_mm_s / count
    total = 0.0
    for branch in branches:
        h = step_s / branch.time_s
        even = -math.expm1(-h) / h
        left = np.exp(-h * np.arange(count - 1, -1, -1.0))
        total += branch.relative_modulus * even * float(growth @ left)
    return total
