# SPDX-License-Identifier: Apache-2.0
"""Success rates and closed forms of torsion: against formulas and by hand."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.tasks.result import TaskResult, TaskTrial, success_interval
from taccel_lab.tasks.twist import Torsion, contact_radius

Z = 1.959963984540054


@pytest.mark.parametrize(("successes", "trials"), [(0, 5), (3, 7), (63, 64), (10, 10)])
def test_interval_is_wilsons(successes: int, trials: int) -> None:
    rate, low, high = success_interval(successes, trials)
    middle = (rate + Z**2 / (2 * trials)) / (1 + Z**2 / trials)
    spread = math.sqrt(rate * (1 - rate) / trials + Z**2 / (4 * trials**2))
    half = Z * spread / (1 + Z**2 / trials)
    assert rate == successes / trials
    assert (low, high) == pytest.approx((middle - half, middle + half), abs=1e-9)
    assert 0 <= low <= rate <= high <= 1 and low < high


def test_the_lines_that_judge_a_robot_are_true(capsys: pytest.CaptureFixture[str]) -> None:
    """The page's own lines: Wilson's intervals as ours, McNemar's test as coins that fall."""
    page = (Path(__file__).parents[2] / "docs" / "tasks.md").read_text(encoding="utf-8")
    (lines,) = re.findall(r"^## On a robot$.*?```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {}
    exec(lines, names)
    told = capsys.readouterr().out.splitlines()
    for name in ("touch", "blind"):
        _, low, high = success_interval(sum(names[name]), 10)
        assert f"{name}: {low:.0%} to {high:.0%}" in told and f"{low:.0%} to {high:.0%}" in lines
    # Four starts that touch alone masters: four coins that all show one side, either of two.
    assert names["mcnemar"] == pytest.approx(2 * 0.5**4) and told[2] == "p = 0.125"
    assert lines.rstrip().endswith("0.125")


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (3, 2), (-1, 4)])
def test_what_makes_no_rate_is_refused(successes: int, trials: int) -> None:
    with pytest.raises(InputError, match="make no rate"):
        success_interval(successes, trials)


def test_a_solver_failure_counts_as_failure_with_its_cause() -> None:
    trials = [
        TaskTrial(0, True, "", 9, {"x_mm": 1.0}, {"slip_mm": 0.1}),
        TaskTrial(1, False, "solver: NO_CONVERGENCE in step 4", 3, {"x_mm": 0.0}, {}),
        TaskTrial(2, False, "rose by 1.0 mm", 9, {"x_mm": 2.0}, {"slip_mm": 0.3}),
        TaskTrial(3, True, "", 9, {"x_mm": 2.0}, {"slip_mm": float("nan")}),
    ]
    table = TaskResult("lift", trials, 1.0, 6).table()
    assert (table["successes"], table["trials"], table["asked"]) == (2, 4, 6)
    assert table["success_rate"] == 0.5 and table["solver_failures"] == 1
    assert table["figures"]["slip_mm"]["median"] == pytest.approx(0.2)
    assert [row["cause"] for row in table["per_seed"]] == [trial.cause for trial in trials]
    assert json.loads(json.dumps(to_jsonable(table)))["per_seed"][3]["slip_mm"] is None


def test_cells_are_told_apart() -> None:
    trials = [
        TaskTrial(0, True, "", 9, {}, {}, cell=("hand", "nut")),
        TaskTrial(1, False, "slipped: rose by 1.0 mm", 9, {}, {}, cell=("hand", "nut")),
        TaskTrial(2, False, "solver: OVERLAP in step 1", 0, {}, {}, cell=("claw", "nut")),
        TaskTrial(3, False, "slipped: rose by 7.0 mm", 9, {}, {}, cell=("hand", "nut")),
    ]
    table = to_jsonable(TaskResult("lift", trials, 1.0, 4).table())
    first, second = table["cells"]
    assert first["cell"] == ["hand", "nut"] and first["causes"] == {"slipped": 2}
    assert (first["successes"], first["trials"]) == (1, 3)
    assert first["interval_95"] == list(success_interval(1, 3)[1:])
    assert second["success_rate"] == 0 and second["causes"] == {"solver": 1}
    assert [row["cell"][0] for row in table["per_seed"]] == ["hand", "hand", "claw", "hand"]
    assert "cells" not in TaskResult("lift", [TaskTrial(0, True, "", 9, {}, {})], 1.0, 1).table()


SHEAR_PA, CONTACT_M, FORCE_N = 3.5e4, 2e-3, 0.15


def torsion(friction: float, angle_rad: float) -> Torsion:
    return Torsion(SHEAR_PA, CONTACT_M, FORCE_N, friction, angle_rad)


def test_contact_radius_is_hertzs() -> None:
    """F = 4/3 E* sqrt(R) d^1.5 and a^2 = R d."""
    depth, ball, young, poisson = 3e-4, 1e-2, 1e5, 0.4
    force = 4 / 3 * young / (1 - poisson**2) * np.sqrt(ball) * depth**1.5
    assert contact_radius(force, ball, young, poisson) == pytest.approx(np.sqrt(ball * depth))


def test_without_slip_it_is_a_disc_that_is_glued_on() -> None:
    """Torque 16/3 G a^3 theta, and around it 2 theta r / pi (asin(a / r) - a / r sqrt(1 - ..))."""
    turned = torsion(1e7, 0.1)
    assert turned.stuck_part == pytest.approx(1.0, abs=1e-6)
    assert turned.torque_nm == pytest.approx(turned.stuck_nm, rel=1e-6)
    assert turned.stuck_nm == pytest.approx(16 / 3 * SHEAR_PA * CONTACT_M**3 * 0.1)
    r = CONTACT_M * np.array([0.2, 0.7, 1.3, 4.0])
    part = np.minimum(CONTACT_M / r, 1.0)
    outside = 0.2 / np.pi * r * (np.arcsin(part) - part * np.sqrt(1 - part**2))
    np.testing.assert_allclose(turned.moved_m(r), outside, rtol=1e-5)


def test_far_turned_it_slips_everywhere() -> None:
    turned = torsion(0.5, 20.0)
    assert turned.stuck_part < 1e-6
    assert turned.torque_nm == pytest.approx(turned.limit_nm, rel=1e-4)
    lever = CONTACT_M**3 * quad(lambda s: s**2 * np.sqrt(1 - s**2), 0, 1)[0]
    peak = 1.5 * FORCE_N / (np.pi * CONTACT_M**2)
    assert turned.limit_nm == pytest.approx(0.5 * 2 * np.pi * peak * lever, rel=1e-9)


@pytest.mark.parametrize("angle_deg", [0.5, 3.0, 10.0])
def test_what_sticks_turns_as_one_and_what_slips_lags(angle_deg: float) -> None:
    angle = np.radians(angle_deg)
    turned = torsion(1.0, angle)
    edge = turned.stuck_part * CONTACT_M
    inside, outside = edge * np.array([0.1, 0.5, 0.999]), np.array([1.001 * edge, CONTACT_M])
    np.testing.assert_allclose(turned.moved_m(inside), angle * inside, rtol=1e-9)
    lag = turned.moved_m(outside) / (angle * outside)
    assert lag[1] < lag[0] < 1.0 and lag[0] > 0.99
    assert turned.moved_m(np.zeros(1)) == 0.0
    assert 0 < turned.torque_nm < min(turned.stuck_nm, turned.limit_nm)


def test_torque_and_flow_are_of_one_traction() -> None:
    """The slope of torque over angle is 16/3 G c^3 of the disc that still sticks."""
    angle, step = np.radians(6.0), 1e-5
    slope = (torsion(1.0, angle + step).torque_nm - torsion(1.0, angle - step).torque_nm) / 2 / step
    disc = torsion(1.0, angle).stuck_part * CONTACT_M
    assert slope == pytest.approx(16 / 3 * SHEAR_PA * disc**3, rel=1e-5)


def test_what_is_no_contact_is_refused() -> None:
    with pytest.raises(InputError, match="friction must be positive"):
        torsion(0.0, 0.1)
    with pytest.raises(InputError, match="angle_rad must be at least 0"):
        torsion(1.0, -0.1)
