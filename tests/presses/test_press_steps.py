# SPDX-License-Identifier: Apache-2.0
"""Steps in time of gels that relax, against the exact hereditary integral."""

from __future__ import annotations

import math

import pytest
from scipy.integrate import quad

from taccel_lab.presses import PressPath
from taccel_lab.presses.press_path import TIME_SHARE
from taccel_lab.scene import MaxwellBranch


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
    depths, total = [0.0, *(point[0] for point in path.waypoints())], 0.0
    end_s = path.depth_mm / path.speed_mm_s
    for b in branches:
        q = 0.0
        for low, high, dt in zip(depths[:-1], depths[1:], path.durations_s(), strict=True):
            growth = (high / path.depth_mm) ** 1.5 - (low / path.depth_mm) ** 1.5
            h = dt / b.time_s
            q = math.exp(-h) * q + b.relative_modulus * (1 - math.exp(-h)) / h * growth
        total += q
    assert sum(path.durations_s()) == pytest.approx(end_s)
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
def test_steps_follow_the_branches(
    depth_mm: float, speed_mm_s: float, branches: list[tuple[float, float]]
) -> None:
    law = [MaxwellBranch(*branch) for branch in branches]
    given = PressPath(depth_mm, speed_mm_s=speed_mm_s)
    path = given.bounded(law, 0.0)
    true = exact(path, law)
    assert abs(in_steps(path, law) - true) <= 1.05 * TIME_SHARE * (1 + true)
    count, few = len(path.way_there()), len(given.way_there())
    assert count % few == 0
    if count > few:
        coarser = path.with_steps(0.5)
        assert abs(in_steps(coarser, law) - true) > TIME_SHARE * (1 + true), "no more than needed"


def test_gels_that_neither_rub_nor_relax_keep_their_steps() -> None:
    path = PressPath(0.2)
    assert path.bounded((), 0.0) is path
    assert len(path.bounded([MaxwellBranch(1.0, 1e6)], 0.0).way_there()) == 2


def test_a_rubbing_contact_is_not_laid_down_at_once() -> None:
    assert [depth for depth, *_ in PressPath(0.1).bounded((), 0.3).waypoints()] == [0.05, 0.1]
    aside = PressPath(0.1, shear_mm=(0.2, 0.0))
    assert aside.bounded((), 0.3).waypoints()[:2] == [(0.05, (0, 0), 0), (0.1, (0, 0), 0)]
    deeper = PressPath(0.6)
    assert deeper.bounded((), 0.3) is deeper
