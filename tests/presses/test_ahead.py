# SPDX-License-Identifier: Apache-2.0
"""Presses of balls whose search starts where columns of the gel are squeezed and nodes have the gap
that bears their push: the same result, in fewer iterations. So has a way that was gone before."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

import taccel_lab as tl
from taccel_lab.presses import PressEnv, PressSetup, profile_material
from taccel_lab.presses.options import PressOptions
from taccel_lab.presses.run import PressRun

CASES = {
    "flat": ("gelsight_mini", {"friction": 0.0}, 0.45),
    "flat, rubbing": ("gelsight_mini", {"friction": 0.3}, 0.6),
    "dome": ("digit", {"friction": 0.0}, 0.45),
}
STEPS_MM = (0.25, 0.5, 0.85, 1.2, 0.9, 0.6)


def env_of(sensor: str, **options: object) -> tuple[PressEnv, PressRun]:
    options = {"indenter": "sphere:4", "depth_mm": 0.5, "step_mm": 0.25, **options}
    run = PressRun.plan(sensor, PressOptions.of(**options))
    material = profile_material(run.profile.material, run.gel)
    at_mm = np.array([run.options.at_mm])
    physics = run.near(run.physics, run.options.path(0.5), run.friction)
    env = PressEnv(PressSetup(run.gel, material, run.indenter, run.friction, physics), at_mm)
    return env, run


def pressed(
    env: PressEnv, steps_mm: tuple[float, ...] = (0.25, 0.5)
) -> tuple[float, int, int, np.ndarray]:
    reports = [env.move_to(depth_mm) for depth_mm in steps_mm]
    return (
        float(env.wrench[0, 2]),
        sum(int(report.newton_iterations[0]) for report in reports),
        sum(int(report.cg_iterations[0]) for report in reports),
        env.positions[0].copy(),
    )


@pytest.mark.parametrize("case", CASES)
def test_a_look_ahead_saves_iterations_and_changes_no_result(case: str) -> None:
    sensor, options, most = CASES[case]
    env, _ = env_of(sensor, **options)
    force, iterations, _, positions = pressed(env)
    without, _ = env_of(sensor, **options)
    without._ahead = None
    usual, more, _, there = pressed(without)
    assert iterations <= most * more, (iterations, more)
    assert force == pytest.approx(usual, rel=1e-4)
    assert np.abs(positions - there).max() < 2e-7


def test_a_deep_press_and_its_way_back_take_no_more_iterations() -> None:
    env, _ = env_of("gelsight_mini", friction=0.0)
    force, iterations, solves, _ = pressed(env, STEPS_MM)
    without, _ = env_of("gelsight_mini", friction=0.0)
    without._ahead = None
    usual, more, solved, _ = pressed(without, STEPS_MM)
    assert force == pytest.approx(usual, rel=2e-4)
    assert iterations < 0.8 * more and solves < solved


def test_where_ahead_is_no_place_to_be_the_search_starts_as_ever() -> None:
    env, _ = env_of("gelsight_mini", friction=0.0)
    usual = pressed(env)
    lost, _ = env_of("gelsight_mini", friction=0.0)
    lost._ahead = None
    there = pressed(lost)
    lost.reset()

    def inside_out(places: wp.array) -> None:
        places.assign(-lost.state.positions.numpy())

    step = lost.solver.step
    lost.solver.step = lambda *args, **kwargs: step(*args, **{**kwargs, "ahead": inside_out})  # type: ignore[method-assign]
    again = pressed(lost)
    assert again[:2] == there[:2] and usual[0] == pytest.approx(again[0], rel=1e-4)


@pytest.mark.thorough
def test_a_way_in_fewer_steps_searches_from_where_more_have_led() -> None:
    def fewer(keeps: bool) -> tuple[float, int]:
        env, _ = env_of("gelsight_mini", indenter="cylinder:2", friction=0.5)
        env.places.kept = keeps
        pressed(env)
        env.reset()
        return pressed(env, (0.5,))[:2]

    force, iterations = fewer(keeps=True)
    usual, more = fewer(keeps=False)
    assert iterations < 0.6 * more, (iterations, more)
    assert force == pytest.approx(usual, rel=2e-3)


def test_places_are_those_of_the_way_down_or_of_the_way_up() -> None:
    env, _ = env_of("gelsight_mini", friction=0.0)
    env.places.kept = True
    pressed(env, (0.25, 0.5, 0.25))
    env.reset()
    known = {round(float(np.frombuffer(way)[0]) * 1e3, 3) for way in env.places.known}
    assert len(env.places.known) == 3 and known == {0.25, 0.5}


def test_places_of_a_turn_are_those_of_its_way_out_or_back() -> None:
    env, _ = env_of("gelsight_mini", friction=0.5)
    env.places.kept = True
    for twist_deg in (0.0, 2.0, 4.0, 2.0):
        env.move_to(0.25, twist_deg=twist_deg)
    env.reset()
    assert len(env.places.known) == 4


@pytest.mark.thorough
@pytest.mark.parametrize(("friction", "steps"), [(0.0, 1), (0.3, 6)])
def test_the_press_beside_a_ball_takes_few_steps(friction: float, steps: int) -> None:
    found = tl.press("gelsight_mini", "sphere:4", depth_mm=0.4, step_mm=0.05, friction=friction)
    assert found.below is not None and len(found.below.steps) == steps
    assert len(found.steps) == 8
    # Half of what four steps add, by 2 and 4 of them.
    assert found.error is not None
    assert found.error.steps_share == pytest.approx(0.0015 if friction else 0.0, abs=0.0007)
