# SPDX-License-Identifier: Apache-2.0
"""Policies of tasks, and the PPO example."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

from taccel_lab.learning.catalogue import make_vec
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.tasks.catalogue import named, run_task
from taccel_lab.tasks.grasp_scene import GRASPERS
from taccel_lab.tasks.result import success_interval
from tests.support.variants import variants
from tests.tasks.changed import parameters
from tests.test_architecture import HEAVY


def baseline(seeds: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    peg = parameters("peg-insertion")
    env = make_vec("peg-insertion", len(seeds), autoreset_mode=AutoresetMode.DISABLED, device="cpu")
    starts, _ = peg.start.draw(seeds)
    rows = [[start[name] for name in env.task.start_names] for start in starts]
    env.reset(options={"start": rows})
    success = np.zeros(len(seeds), dtype=bool)
    depth = np.full(len(seeds), np.nan)
    path = np.array(peg.policy.gel_mm)[:, 2]
    for step in range(1, peg.steps + 1):
        times = peg.dt_s * np.array([step - 1, step])
        before, after = np.interp(times, peg.policy.times_s, path)
        part = (after - before) / (peg.learning.speed_mm_s[2] * peg.dt_s)
        going = np.isnan(depth)
        action = torch.tensor([[0.0, 0.0, part, 0.0]]).repeat(len(seeds), 1)
        _, _, terminated, truncated, info = env.step(action)
        ended = terminated | truncated
        success |= going & terminated.numpy()
        now = going & ended.numpy()
        depth[now] = info["depth_mm"].numpy()[now]
        if ended.any():
            env.reset(options={"reset_mask": ended})
    return success, depth


@pytest.mark.thorough
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
    """53 of 64 as measured, see docs/tasks.md, with its interval; where a step that meets the rim
    has two solutions, the last digits decide which is found."""
    missed = [not trial.success for trial in run_task(named("peg-insertion"), range(64)).trials]
    failed = ~baseline(range(64))[0]
    assert np.count_nonzero(failed != missed) <= 2
    _, low, high = success_interval(53, 64)
    assert low <= 1 - failed.mean() <= high


@pytest.mark.thorough
def test_actions_move_both_gels_within_their_reach() -> None:
    """After the first step, which closes: by their speeds, and no farther than their reach."""
    learning, dt = parameters("peg-insertion").learning, parameters("peg-insertion").dt_s
    env = make_vec("peg-insertion", 1, observe=("proprioception",), device="cpu")
    env.reset(seed=0)
    poses = []
    for action in ([1.0, 1.0, 1.0, 1.0], [1.0, -1.0, 0.5, 1.0], [9.0, 0.0, 0.0, -1.0]):
        seen = env.step(torch.tensor([action]))[0]["proprioception"][0]
        poses.append(env.state.poses.numpy()[0, :2].copy())
    x, y, z = (speed * dt for speed in learning.speed_mm_s)
    np.testing.assert_allclose(seen, [2 * x, -y, 0.5 * z, 0.0], atol=1e-5)
    closed, turned, _ = poses
    np.testing.assert_allclose(closed[1, :3], [16.5e-3, 0, 71e-3], atol=1e-12)
    turn = np.radians(learning.turn_deg_s * dt)
    between = turned[1, :3] - turned[0, :3]
    np.testing.assert_allclose(between, 33e-3 * np.array([np.cos(turn), np.sin(turn), 0]))
    for _ in range(30):
        seen = env.step(torch.tensor([[-1.0, 0.0, 1.0, 1.0]]))[0]["proprioception"][0]
    wanted = [-learning.reach_mm[0], -y, 0.5 * z + 29 * z, learning.reach_deg]
    np.testing.assert_allclose(seen, np.minimum(wanted, [9, 9, learning.reach_mm[2], 9]), atol=0.7)


def starts(seeds: list[int], name: str) -> list[list[float]]:
    drawn, _ = parameters(name).start.draw(seeds)
    return [[start[name] for name in ("x_mm", "y_mm", "yaw_deg")] for start in drawn]


@pytest.mark.parametrize("name", ["grasp-lift", "grasp-lift-hand"])
def test_the_gripper_begins_where_the_task_has_it(name: str) -> None:
    """Relative to the object: all of its bodies, in the order of the scene."""
    seeds = [0, 3]
    episode = named(name).begin(seeds, "cpu")
    env = make_vec(name, 2, device="cpu")
    env.reset(options={"start": starts(seeds, name)})
    _, offset = parameters(name).start.draw(seeds)
    wanted = np.linalg.inv(matrix_of(offset))[:, None] @ matrix_of(episode.state.poses.numpy())
    np.testing.assert_allclose(matrix_of(env.state.poses.numpy()), wanted, rtol=0, atol=1e-12)
    names = [body.name for body in env.model.scene.kinematic_bodies]
    assert names == [body.name for body in episode.model.scene.kinematic_bodies]


@pytest.mark.thorough
@pytest.mark.parametrize("name", variants(["grasp-lift"], ["grasp-lift", "grasp-lift-hand"]))
def test_the_baseline_lifts_as_in_the_task(name: str) -> None:
    """Close until all gels push with 4 N, rise, stay: success as soon as it was high for 1 s."""
    seeds, told = [0], parameters(name)
    policy, dt = told.policy, told.dt_s
    (trial,) = run_task(named(name), seeds, "cpu").trials
    env = make_vec(name, 1, device="cpu")
    seen, _ = env.reset(options={"start": starts(seeds, name)})
    closed = GRASPERS[told.robot].closed
    unit = 1e-3 if told.robot == "parallel_gripper" else np.radians(1.0)
    seat = np.array([1e-3 * policy.open_mm])
    gripping = torch.zeros(1, dtype=torch.bool)
    done, total = torch.zeros(1, dtype=torch.bool), torch.zeros(1)
    for _ in range(told.steps):
        gripping |= (seen["wrench"][:, :, 2] < -policy.grip_n).all(dim=1)
        raised = seen["proprioception"][:, 2]
        up = gripping & (raised < policy.lift_mm - 1e-3)
        seat = np.maximum(seat - 1e-3 * policy.close_mm_s * dt, 1e-3 * policy.closed_mm)
        way = torch.tensor(closed(seat)[0] / unit) - seen["proprioception"][:, 4:]
        action = torch.zeros(env.action_space.shape)
        action[:, 4:] = torch.where(gripping[:, None], 0.0, way / (told.learning.joint_speed * dt))
        assert (action.abs() <= 1 + 1e-3).all()
        action[:, 2] = torch.where(up, ((policy.lift_mm - raised) / 2).clamp(max=1.0), 0.0)
        seen, reward, terminated, truncated, info = env.step(action)
        total += torch.where(done, 0.0, reward)
        assert not (truncated & ~done).any()
        done |= terminated
        if done.all():
            break
    assert done.all() and trial.success
    # The way up counts 1 once, the end 1 more.
    assert ((total > 1.95) & (total < 2.1)).all() and info["rise_mm"].max() > 100


def test_an_empty_gripper_goes_where_it_is_told() -> None:
    lift = parameters("grasp-lift")
    learning, dt = lift.learning, lift.dt_s
    env = make_vec("grasp-lift", 1, observe=("proprioception",), device="cpu")
    env.reset(options={"start": [[0.0, 0.0, 90.0]]})
    before = env.state.poses.numpy()[0].copy()
    for action in ([1.0, 0.0, 1.0, 0.0, -1.0], [0.0, -0.5, 0.5, 1.0, 3.0]):
        seen = env.step(torch.tensor([action]))[0]["proprioception"][0]
    way = [learning.speed_mm_s[0], -0.5 * learning.speed_mm_s[1], 1.5 * learning.speed_mm_s[2]]
    wanted = [*(dt * speed for speed in way), dt * learning.turn_deg_s, lift.policy.open_mm]
    np.testing.assert_allclose(seen, wanted, atol=1e-4)
    moved = 1e3 * (env.state.poses.numpy()[0].mean(axis=0) - before.mean(axis=0))[:3]
    # It began turned by -90 degrees, and moves in that frame.
    np.testing.assert_allclose(moved, [wanted[1], -wanted[0], wanted[2]], atol=0.05)


ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "notebooks" / "ppo_peg_insertion.py"
SCRIPT = """
import runpy, sys
sys.modules.update(dict.fromkeys({absent!r}))  # None makes the import of a module fail.
import warp as wp
wp.config.log_level = wp.LOG_ERROR
sys.argv = ["ppo_peg_insertion.py", *{arguments!r}]
runpy.run_path({path!r}, run_name="__main__")
"""


@pytest.mark.thorough
def test_two_updates_on_a_bare_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    absent = [name for name in HEAVY if name not in ("warp", "torch", "scipy")]
    absent += ["pydantic", "rich", "tyro", "jinja2", "tomli_w", "safetensors", "PIL", "yaml"]
    arguments = "--envs 3 --updates 2 --steps 6 --minibatches 18 --judge 0 --randomised --output"
    words = [*arguments.split(), str(tmp_path)]
    code = SCRIPT.format(absent=absent, arguments=words, path=str(EXAMPLE))
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "update 2/2, 36 steps" in done.stdout
    curve = json.loads((tmp_path / "curve.json").read_text())
    assert curve["complete"] and curve["settings"]["envs"] == 3
    assert [row["env_steps"] for row in curve["rows"]] == [18, 36]
    # A row a minibatch: its own mean, with no deviation.
    assert all(np.isfinite([row["policy_loss"], row["std"]]).all() for row in curve["rows"])
    assert (tmp_path / "policy.pt").stat().st_size > 10_000
    assert not (tmp_path / "curve.png").exists(), "there is no matplotlib to draw it"
    monkeypatch.setattr(sys, "argv", ["ppo_peg_insertion.py", "--draw", str(tmp_path)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
