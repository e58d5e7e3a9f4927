# SPDX-License-Identifier: Apache-2.0
"""Presses of gels that relax: speed, hold and way back; of other gels time changes nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.presses import PressOutcome, PressPath, parse_indenter, simulate_press
from taccel_lab.presses.press_path import HOLD_STEPS
from taccel_lab.scene import Material, MaxwellBranch
from tests.support.blocks import block_mesh
from tests.support.coarse_pads import GEL, LINEAR

MESH = block_mesh((6, 6, 3), (8e-3, 8e-3, 3e-3))
BRANCH = MaxwellBranch(0.4, 2.0)
RELAXING = replace(GEL, branches=(BRANCH,))
PATH = PressPath(0.5)
DOWN = len(PATH.way_there())


def pressed(path: PressPath, material: Material = RELAXING, friction: float = 0.0) -> PressOutcome:
    return simulate_press(
        MESH, material, parse_indenter("sphere:3"), (0.0, 0.0), path, PixelGrid(16, 16, 0.4, 0.4),
        friction_coefficient=friction, physics=LINEAR,
    )  # fmt: skip


def forces(outcome: PressOutcome) -> np.ndarray:
    return np.array([step.wrench[2] for step in outcome.steps])


@pytest.fixture(scope="module")
def plain():
    return pressed(PATH, GEL)


def test_a_hold_is_where_the_indenter_is_and_takes_its_time():
    path = replace(PATH, shear_mm=(0.1, 0.0), twist_deg=4.0, hold_s=8.0, back=True, speed_mm_s=0.5)
    points, times, there = path.waypoints(), path.durations_s(), path.way_there()
    assert len(points) == len(times) == 2 * len(there) + HOLD_STEPS
    held = slice(len(there), len(there) + HOLD_STEPS)
    assert set(points[held]) == {there[-1]} and points[-1] == (0.0, (0.0, 0.0), 0.0)
    assert sum(times[held]) == pytest.approx(8.0)
    assert (np.diff(times[held]) > 0).all()
    # Down and up at 0.5 mm/s; the turn of two steps takes as long as two of 0.2 mm.
    assert sum(times[:DOWN]) == sum(times[-DOWN:]) == pytest.approx(1.0)
    assert sum(times[DOWN : held.start]) == pytest.approx(0.8)


def test_a_hold_relaxes_and_a_way_back_loses_work(plain):
    outcome = pressed(replace(PATH, hold_s=6.0, back=True))
    found, relaxed = forces(outcome), forces(plain)[-1]
    held = found[DOWN - 1 : DOWN + HOLD_STEPS]
    assert (np.diff(held) < 0).all()
    # Of 0.4 what 0.5 s of loading and 6 s leave, by a force that grows as depth^1.5 does.
    assert held[0] / relaxed == pytest.approx(1 + 0.4 * 0.91, rel=0.01)
    left = (held[-1] - relaxed) / (held[0] - relaxed)
    assert left == pytest.approx(np.exp(-6.0 / BRANCH.time_s), abs=0.01)
    figures = outcome.figures()
    assert figures["hold"] == {"from_n": held[0], "to_n": held[-1], "seconds": 6.0}
    assert 0.2 < figures["loop"]["lost_share"] < 0.5
    times = [step["time_s"] for step in figures["steps"]]
    assert times[DOWN - 1] == pytest.approx(0.5) and times[-1] == pytest.approx(7.0)
    assert abs(found[-1]) < 1e-6 < found[-2], "it has left a gel that is still dented"
    assert (outcome.rest_height_m - outcome.height_m).max() > 1e-5


@pytest.mark.thorough
def test_friction_holds_while_the_indenter_rests(plain):
    """However long: static friction allows as little sliding in a long step as in a short one."""
    path = replace(PATH, hold_s=60.0)
    found, relaxed = (forces(pressed(path, gel, 1.0))[-1] for gel in (RELAXING, GEL))
    assert relaxed > 1.02 * forces(plain)[-1]
    assert found == pytest.approx(relaxed, rel=5e-3)


@pytest.mark.thorough
def test_a_slow_press_is_softer_than_a_fast_one(plain):
    for speed, ratio, rel in ((1e3, 1.4, 2e-3), (1e-3, 1.0, 2e-2)):
        found = forces(pressed(replace(PATH, speed_mm_s=speed)))[-1]
        assert found / forces(plain)[-1] == pytest.approx(ratio, rel=rel)


@pytest.mark.thorough
def test_a_gel_that_does_not_relax_goes_back_as_it_came(plain):
    outcome = pressed(replace(PATH, back=True), GEL)
    found = forces(outcome)
    np.testing.assert_array_equal(found[:DOWN], forces(plain))
    np.testing.assert_allclose(found[DOWN:-1], found[: DOWN - 1][::-1], rtol=2e-3)
    assert outcome.figures()["loop"]["lost_share"] < 2e-3
    figures = plain.figures()
    assert not {"hold", "loop"} & {*figures} and "time_s" not in figures["steps"][0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"hold_s": 1.0}, "does not relax"),
        ({"speed_mm_s": 1.0}, "does not relax"),
        ({"hold_s": -1.0}, "hold must lie"),
        ({"speed_mm_s": 0.0}, "speed must lie"),
        ({"unload": True, "accuracy": "3%"}, "--unload takes away"),
    ],
)
def test_what_makes_no_sense_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        tl.press("flat_pad", "sphere:4", depth_mm=0.3, **options)
