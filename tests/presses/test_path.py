# SPDX-License-Identifier: Apache-2.0
"""Paths of a press: where they end, how long steps are; how deep a press goes for a force."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.presses import PressPath, PressStep, press_to_force
from taccel_lab.presses.force_search import by_power_law
from taccel_lab.presses.path import TIME_SHARE
from taccel_lab.scene import MaxwellBranch

lengths = st.floats(-5, 5)


@given(
    depth=st.floats(1e-3, 5), shear=st.tuples(lengths, lengths), twist=st.floats(-90, 90),
    step_mm=st.floats(0.02, 3), step_deg=st.floats(0.1, 30),
)  # fmt: skip
def test_waypoints(depth, shear, twist, step_mm, step_deg):
    given_ = (depth, shear, twist, step_mm, step_deg)
    path = PressPath(*given_).waypoints()
    assert path[-1] == (depth, shear, twist)
    for previous, point in itertools.pairwise([(0.0, (0.0, 0.0), 0.0), *path]):
        # First straight down, then sideways and round at full depth.
        assert point[0] == depth or (point[1], point[2]) == ((0.0, 0.0), 0.0)
        assert 0 <= point[0] - previous[0] <= step_mm * (1 + 1e-6)
        assert math.dist(point[1], previous[1]) <= step_mm * (1 + 1e-6)
        assert abs(point[2] - previous[2]) <= step_deg * (1 + 1e-6)
    # No step more than needed: one fewer would make them too long.
    down = sum(point[1] == (0.0, 0.0) and point[2] == 0.0 for point in path)
    needed = max(1, math.ceil(depth / step_mm))
    side = max(math.hypot(*shear) / step_mm, abs(twist) / step_deg)
    assert down <= needed and len(path) <= needed + math.ceil(side)
    # The way back is the way there.
    loop = PressPath(*given_, back=True).waypoints()
    assert loop == [*path, *reversed(path[:-1]), (0.0, (0.0, 0.0), 0.0)]


def test_steps_are_even_and_not_split_by_rounding():
    assert len(PressPath(0.6, step_mm=0.2).waypoints()) == 3
    assert len(PressPath(0.2, (0.3, 0.0), step_mm=0.1).waypoints()) == 5
    path = PressPath(0.5, (0.3, -0.4), -6.0, step_mm=0.25, step_deg=2.0).waypoints()
    assert [p[0] for p in path] == [0.25, 0.5, 0.5, 0.5, 0.5]
    assert [p[2] for p in path] == [0.0, 0.0, -2.0, -4.0, -6.0]
    sideways = np.diff([p[1] for p in path[1:]], axis=0)
    assert sideways == pytest.approx(np.tile([0.1, -0.4 / 3], (3, 1)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"depth_mm": 0.0}, "depth must be positive and finite, got 0 mm"),
        ({"depth_mm": 101.0}, r"depth must lie in \[0, 100\] mm, got 101"),
        ({"depth_mm": math.nan}, "depth must be positive and finite"),
        ({"shear_mm": (math.nan, 0.0)}, "shear must lie in"),
        ({"shear_mm": (0.0, -21.0)}, r"shear must lie in \[-20, 20\] mm, got -21"),
        ({"twist_deg": math.inf}, "twist must lie in"),
        ({"twist_deg": -181.0}, r"twist must lie in \[-180, 180\] deg, got -181"),
        ({"step_mm": 0.0}, "step_mm must be positive and finite, got 0"),
        ({"step_deg": -1.0}, "step_deg must be positive and finite, got -1"),
        ({"step_mm": 1e-9}, "step_mm 1e-09 .* more than 10000 steps"),
        ({"twist_deg": 90.0, "step_deg": 1e-4}, "step_deg 0.0001 make more than 10000 steps"),
    ],
)
def test_paths_that_no_press_takes_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        PressPath(**{"depth_mm": 0.5, **changes})


@dataclasses.dataclass
class FormulaGel:
    """A gel that feels ``law(depth)`` and breaks beyond a depth."""

    law: Callable[[float], float] = lambda depth: 2 * depth**1.5
    breaks_mm: float = np.inf
    depths: list[float] = dataclasses.field(default_factory=list)

    def press(self, depth_mm: float, told: Callable[[int, int, PressStep], None]) -> Any:
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
        return path


@given(st.floats(0.05, 50), st.floats(0.9, 2.1), st.floats(0.0, 3.0), st.floats(0.02, 2.9))
def test_the_depth_of_a_hardening_gel_is_found(stiffness, power, hardening, depth_mm):
    gel = FormulaGel(lambda depth: stiffness * depth**power * (1 + hardening * depth**2))
    found = press_to_force(gel.law(depth_mm), gel.press, 3.0).depth_mm
    assert gel.law(found) == pytest.approx(gel.law(depth_mm), rel=0.01)
    assert found == gel.depths[-1] <= 3.0
    assert len(gel.depths) <= 9


@pytest.mark.parametrize(
    ("breaks_mm", "first_mm", "depths"), [(np.inf, 1.001, [1.001]), (1.5, 2.5, [2.5, 1.0])]
)
def test_a_good_guess_needs_one_press_and_one_that_breaks_the_gel_two(breaks_mm, first_mm, depths):
    """It had passed the force when it broke."""
    gel = FormulaGel(breaks_mm=breaks_mm)
    press_to_force(2.0, gel.press, 3.0, first_mm=first_mm)
    assert gel.depths == pytest.approx(depths, rel=1e-3)


@pytest.mark.parametrize(
    ("force_n", "breaks_mm", "error", "words"),
    [
        (100.0, np.inf, InputError, r"100 N is not reached.* 3 mm, ends at 10.4 N"),
        (9.0, 2.0, SimulationError, r"9 N was not reached: did not converge at 2\.\d"),
        *[(f, np.inf, InputError, "positive and finite") for f in (0.0, -1.0, np.nan, np.inf)],
    ],
)
def test_what_cannot_be_reached_is_said(force_n, breaks_mm, error, words):
    gel = FormulaGel(breaks_mm=breaks_mm)
    with pytest.raises(error, match=words):
        press_to_force(force_n, gel.press, 3.0)
    assert force_n != 100.0 or gel.depths[-1] == 3.0


def test_power_laws_are_exact_between_and_beside_steps():
    force = np.array([1.0, 3.0, 7.0])
    for load in (0.2, 1.0, 2.0, 6.5, 12.0):
        assert by_power_law(force, 4 * force**0.6, load) == pytest.approx(4 * load**0.6)


def exact(path: PressPath, branches: list[MaxwellBranch]) -> float:
    """Overstress of a force that grows as depth^1.5, by its hereditary integral."""
    end_s = path.depth_mm / path.speed_mm_s

    def grown(s: float, time_s: float) -> float:
        return math.exp(-(end_s - s) / time_s) * 1.5 * math.sqrt(s / end_s) / end_s

    total = 0.0
    for b in branches:
        early = max(end_s - 5 * b.time_s, 0.0)
        total += b.relative_modulus * quad(grown, 0, end_s, (b.time_s,), points=[early])[0]
    return total


def in_steps(path: PressPath, branches: list[MaxwellBranch]) -> float:
    """The same when stress grows evenly over each step."""
    shares = np.array([0.0, *(point[0] for point in path.waypoints())]) / path.depth_mm
    total, times = 0.0, path.durations_s()
    for b in branches:
        q = 0.0
        for growth, dt in zip(np.diff(shares**1.5), times, strict=True):
            h = dt / b.time_s
            q = math.exp(-h) * q + b.relative_modulus * (1 - math.exp(-h)) / h * growth
        total += q
    assert sum(times) == pytest.approx(path.depth_mm / path.speed_mm_s)
    return total


@pytest.mark.parametrize(
    ("depth_mm", "speed_mm_s", "branches"),
    [
        (0.2, 0.1, [(1.0, 1.0)]),
        (0.2, 1.0, [(2.0, 0.1)]),
        (0.05, 1.0, [(1.0, 0.02)]),
        (0.6, 1.0, [(0.5, 0.05), (0.5, 1.0)]),
        (1.0, 0.1, [(1.0, 0.01)]),
        (0.6, 10.0, [(5.0, 0.02)]),
    ],
)
def test_steps_follow_the_branches(depth_mm, speed_mm_s, branches):
    law = [MaxwellBranch(*branch) for branch in branches]
    given_ = PressPath(depth_mm, speed_mm_s=speed_mm_s)
    path = given_.bounded(law, 0.0)
    true = exact(path, law)
    assert abs(in_steps(path, law) - true) <= 1.05 * TIME_SHARE * (1 + true)
    count, few = len(path.way_there()), len(given_.way_there())
    assert count % few == 0
    if count > few:
        coarser = path.with_steps(0.5)
        assert abs(in_steps(coarser, law) - true) > TIME_SHARE * (1 + true), "no more than needed"


def test_gels_that_neither_rub_nor_relax_keep_their_steps():
    path, deeper = PressPath(0.2), PressPath(0.6)
    assert path.bounded((), 0.0) is path and deeper.bounded((), 0.3) is deeper
    assert len(path.bounded([MaxwellBranch(1.0, 1e6)], 0.0).way_there()) == 2
    # A contact that rubs is not laid down at once.
    assert [depth for depth, *_ in PressPath(0.1).bounded((), 0.3).waypoints()] == [0.05, 0.1]
    aside = PressPath(0.1, shear_mm=(0.2, 0.0))
    assert aside.bounded((), 0.3).waypoints()[:2] == [(0.05, (0, 0), 0), (0.1, (0, 0), 0)]
