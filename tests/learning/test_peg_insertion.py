# SPDX-License-Identifier: Apache-2.0
"""The peg insertion to be learned is the task's: its baseline comes to the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

from taccel_lab.learning.catalogue import make_vec
from taccel_lab.tasks.catalogue import named
from taccel_lab.tasks.run import run_task
from tests.learning.tasks import peg_parameters


def baseline(seeds: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Success and last depth [mm] of the task's policy, told as actions, on its own starts."""
    parameters = peg_parameters()
    env = make_vec("peg-insertion", len(seeds), autoreset_mode=AutoresetMode.DISABLED, device="cpu")
    starts, _ = parameters.start.draw(seeds)
    rows = [[start[name] for name in env.task.start_names] for start in starts]
    env.reset(options={"start": rows})
    success = np.zeros(len(seeds), dtype=bool)
    depth = np.full(len(seeds), np.nan)
    path = np.array(parameters.policy.gel_mm)[:, 2]
    for step in range(1, parameters.steps + 1):
        times = parameters.dt_s * np.array([step - 1, step])
        before, after = np.interp(times, parameters.policy.times_s, path)
        part = (after - before) / (parameters.learning.speed_mm_s[2] * parameters.dt_s)
        going = np.isnan(depth)
        _, _, terminated, truncated, info = env.step(
            torch.tensor([[0.0, 0.0, part, 0.0]]).repeat(len(seeds), 1)
        )
        ended = terminated | truncated
        success |= going & terminated.numpy()
        now = going & ended.numpy()
        depth[now] = info["depth_mm"].numpy()[now]
        if ended.any():
            env.reset(options={"reset_mask": ended})
    return success, depth


def test_the_baseline_goes_in_and_jams_as_in_the_task() -> None:
    jammed, seeds = 1, [0, 8, 2]
    trials = run_task(named("peg-insertion"), seeds, "cpu").trials
    success, depth = baseline(seeds)
    assert success.tolist() == [trial.success for trial in trials] == [True, False, True]
    wanted = trials[jammed].figures["depth_mm"]
    assert depth[jammed] == pytest.approx(wanted, abs=0.3) and wanted < 7
    # An episode ends when the peg is 16 mm deep, in a step of 0.4 mm.
    assert ((depth[success] >= 16) & (depth[success] < 16.5)).all()


@pytest.mark.slow
def test_the_baselines_rate_is_the_tasks() -> None:
    """53 of 64, see docs/tasks.md; of seed 1 the step that meets the rim has two solutions."""
    failed = np.flatnonzero(~baseline(range(64))[0])
    assert sorted({*failed} - {1}) == [8, 10, 25, 34, 43, 51, 53, 56, 60, 63]


def test_actions_move_both_gels_within_their_reach() -> None:
    """After the first step, which closes: by their speeds, and no farther than their reach."""
    learning = peg_parameters().learning
    env = make_vec("peg-insertion", 1, observe=("proprioception",), device="cpu")
    env.reset(seed=0)
    poses = []
    for action in ([1.0, 1.0, 1.0, 1.0], [1.0, -1.0, 0.5, 1.0], [9.0, 0.0, 0.0, -1.0]):
        seen = env.step(torch.tensor([action]))[0]["proprioception"][0]
        poses.append(env.state.poses.numpy()[0, :2].copy())
    x, y, z = (speed * peg_parameters().dt_s for speed in learning.speed_mm_s)
    np.testing.assert_allclose(seen, [2 * x, -y, 0.5 * z, 0.0], atol=1e-5)
    closed, turned, _ = poses
    np.testing.assert_allclose(closed[1, :3], [16.5e-3, 0, 71e-3], atol=1e-12)
    turn = np.radians(learning.turn_deg_s * peg_parameters().dt_s)
    between = turned[1, :3] - turned[0, :3]
    np.testing.assert_allclose(between, 33e-3 * np.array([np.cos(turn), np.sin(turn), 0]))
    for _ in range(30):
        seen = env.step(torch.tensor([[-1.0, 0.0, 1.0, 1.0]]))[0]["proprioception"][0]
    wanted = [-learning.reach_mm[0], -y, 0.5 * z + 29 * z, learning.reach_deg]
    np.testing.assert_allclose(seen, np.minimum(wanted, [9, 9, learning.reach_mm[2], 9]), atol=0.7)
