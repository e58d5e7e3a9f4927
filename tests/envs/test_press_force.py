# SPDX-License-Identifier: Apache-2.0
"""How deep a press has to go for a force, on gels whose curves are formulas."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.envs import PressOutcome, PressPath, PressStep, press_to_force
from taccel_lab.envs.press_force import by_power_law
from taccel_lab.errors import InputError, SimulationError


@dataclasses.dataclass
class Gel:
    """A gel that feels ``law(depth)`` and breaks beyond a depth."""

    law: Callable[[float], float]
    breaks_mm: float = np.inf
    depths: list[float] = dataclasses.field(default_factory=list)

    def press(self, depth_mm: float, told: Callable[[int, int, PressStep], None]) -> PressOutcome:
        self.depths.append(depth_mm)
        path = PressPath(depth_mm, (0.1, 0.0))
        waypoints = path.waypoints()
        for i, (depth, shear, twist) in enumerate(waypoints):
            if depth > self.breaks_mm:
                raise SimulationError(f"did not converge at {depth:.3g} mm")
            # Sideways the force is another one, which must not count.
            force = self.law(depth) * (0.5 if any(shear) else 1.0)
            wrench = np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])
            told(i + 1, len(waypoints), PressStep(depth, shear, twist, wrench, cast("Any", None)))
        return cast("PressOutcome", path)


@given(
    st.floats(0.05, 50), st.floats(0.9, 2.1), st.floats(0.0, 3.0), st.floats(0.02, 2.9)
)  # fmt: skip
def test_the_depth_of_a_hardening_gel_is_found(
    stiffness: float, power: float, hardening: float, depth_mm: float
) -> None:
    def law(depth: float) -> float:
        return stiffness * depth**power * (1 + hardening * depth**2)

    gel = Gel(law)
    outcome = press_to_force(law(depth_mm), gel.press, 3.0)
    found = cast("PressPath", outcome).depth_mm
    assert law(found) == pytest.approx(law(depth_mm), rel=0.01)
    assert found == gel.depths[-1] <= 3.0
    assert len(gel.depths) <= 9


def test_a_good_first_depth_needs_one_press() -> None:
    gel = Gel(lambda depth: 2 * depth**1.5)
    press_to_force(2.0, gel.press, 3.0, first_mm=1.001)
    assert gel.depths == [1.001]


def test_what_cannot_be_reached_is_said() -> None:
    gel = Gel(lambda depth: 2 * depth**1.5)
    with pytest.raises(InputError, match=r"100 N is not reached.* 3 mm, ends at 10.4 N"):
        press_to_force(100.0, gel.press, 3.0)
    assert gel.depths[-1] == 3.0
    with pytest.raises(SimulationError, match=r"9 N was not reached: did not converge at 2\.\d"):
        press_to_force(9.0, Gel(lambda depth: 2 * depth**1.5, 2.0).press, 3.0)
    for force in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="must be above 0 N"):
            press_to_force(force, gel.press, 3.0)


def test_a_guess_that_breaks_the_gel_is_taken_back() -> None:
    """The first press goes too deep; it had passed the force by then."""
    gel = Gel(lambda depth: 2 * depth**1.5, breaks_mm=1.5)
    press_to_force(2.0, gel.press, 3.0, first_mm=2.5)
    assert gel.depths == pytest.approx([2.5, 1.0], rel=1e-3)


def test_power_laws_are_exact_between_and_beside_steps() -> None:
    force = np.array([1.0, 3.0, 7.0])
    for load in (0.2, 1.0, 2.0, 6.5, 12.0):
        assert by_power_law(force, 4 * force**0.6, load) == pytest.approx(4 * load**0.6)
