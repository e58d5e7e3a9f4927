# SPDX-License-Identifier: Apache-2.0
"""The indenter is held back by the mean gap of its contact, with and without sliding."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.envs import PressEnv, parse_indenter
from taccel_lab.envs.press import SETBACK_TOLERANCE
from taccel_lab.solvers import EnvStatus, SolverConfig, StepReport
from tests.support.coarse_pads import GEL, pad

CENTRE = (0.0, 0.0)


def press_env(friction: float, dhat_m: float = 1e-5, env_count: int = 1) -> PressEnv:
    return PressEnv(
        pad(CENTRE),
        GEL,
        parse_indenter("sphere:2.0"),
        np.tile(CENTRE, (env_count, 1)),
        friction_coefficient=friction,
        config=SolverConfig(dhat_m=dhat_m),
    )


def sheared(dhat_m: float) -> np.ndarray:
    """Forces on the indenter [N] as it comes down, shears, and shears on its way down."""
    env = press_env(0.5, dhat_m)
    forces = []
    for depth_mm, shear_mm in ((0.2, 0.0), (0.4, 0.1), (0.5, 0.3)):
        env.move_to(depth_mm, (shear_mm, 0.0))
        assert abs(env._mean_gap_m() - env.setback_m) < SETBACK_TOLERANCE * depth_mm * 1e-3
        forces.append(env.wrench[0, :3])
    return np.array(forces)


def test_forces_of_a_sheared_press_do_not_depend_on_dhat() -> None:
    short, long = sheared(2e-6), sheared(2e-5)
    size = np.linalg.norm(short, axis=1)
    assert (short[1:, 0] < -0.1 * size[1:]).all(), "it is sheared"
    assert (np.linalg.norm(long - short, axis=1) < 0.01 * size).all()


def test_friction_sees_one_step_to_the_corrected_place() -> None:
    """As a step from where the first one ended, the gel would slide by the correction alone, and
    friction would let go a little."""
    env = press_env(0.5, 2e-5)
    start = env.state.copy()
    report = env.move_to(0.3, (0.05, 0.0))
    found = env.wrench[0]
    once = env.solver.step(start, env.poses)
    assert once.converged.all()
    assert report.newton_iterations[0] > once.newton_iterations[0], "it was taken again"
    env.state.positions.assign(start.positions)
    assert found[0] < -0.1 * found[2]
    assert env.wrench[0] == pytest.approx(found, abs=3e-4 * np.linalg.norm(found[:3]))


def test_environments_that_stay_keep_their_friction() -> None:
    env = press_env(0.5, env_count=2)
    env.move_to(0.3, (0.1, 0.0))
    kept = env.positions[1].copy(), env.contact_forces[1].copy(), env.poses[1].copy()
    report = env.try_to(0.5, (0.2, 0.0), stay=np.array([False, True]))
    assert report.status.tolist() == [EnvStatus.CONVERGED, EnvStatus.SKIPPED]
    for before, now in zip(kept, (env.positions, env.contact_forces, env.poses), strict=True):
        np.testing.assert_array_equal(now[1], before)
    assert env.depth_m == pytest.approx([0.5e-3, 0.3e-3])


def test_a_correction_that_fails_leaves_the_environment_where_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env = press_env(0.5, 2e-5, env_count=2)
    before, held_back, depth_m = env.state.copy(), env.setback_m.copy(), env.depth_m.copy()
    step, rounds = env.solver.step, []

    def fail_again(*args: Any, again: bool = False, **more: Any) -> StepReport:
        report = step(*args, again=again, **more)
        rounds.append(again)
        if again:
            report.status[0] = EnvStatus.NO_CONVERGENCE
        return report

    monkeypatch.setattr(env.solver, "step", fail_again)
    report = env.try_to(0.3, (0.05, 0.0))
    assert rounds[:2] == [False, True]
    assert report.converged.tolist() == [False, True]
    assert env.depth_m == pytest.approx([depth_m[0], 0.3e-3])
    assert env.setback_m[0] == held_back[0]
    for now, then in ((env.state.positions, before.positions), (env.state.poses, before.poses)):
        assert isinstance(now, wp.array)
        np.testing.assert_array_equal(now.numpy()[0], then.numpy()[0])
    assert not env.wrench[0].any() and env.wrench[1, 2] > 0, "forces are those of then"
