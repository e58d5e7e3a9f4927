# SPDX-License-Identifier: Apache-2.0
"""Environments for reinforcement learning and their controls."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_match import check_environments_match
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from taccel_lab.benchmarks.learning import background, color_model
from taccel_lab.errors import InputError
from taccel_lab.files.documents import read_toml
from taccel_lab.learning.catalogue import FILES, make_vec, names
from taccel_lab.learning.grasp_lift import JointControl
from taccel_lab.learning.single_env import TactileEnv
from taccel_lab.learning.vector_env import OBSERVATIONS, TactileVectorEnv
from taccel_lab.robots import named as named_robot
from taccel_lab.solvers import EnvStatus
from taccel_lab.tasks.catalogue import named
from tests.learning.envs import as_numpy, short_task
from tests.tasks.changed import parameters, task_with

DOWN = [0.0, 0.0, -1.0, 0.0]


def make(task: Any = "peg-insertion", count: int = 2, **options: Any) -> TactileVectorEnv:
    return make_vec(task, count, device="cpu", **options)


def test_observations_are_of_their_spaces() -> None:
    colors = {"colors": lambda grid: (color_model(grid), background(grid)), "size_px": (40, 30)}
    env = make(observe=OBSERVATIONS, **colors)
    assert isinstance(env, gymnasium.vector.VectorEnv)
    first, _ = env.reset(seed=0)
    assert first["rgb"].shape == (2, 2, 30, 40, 3) and first["depth_m"].shape == (2, 2, 30, 40)
    assert first["markers_px"].shape == (2, 2, 48, 2) and first["wrench"].shape == (2, 2, 6)
    for action in (DOWN, [0.3, -0.2, 0.1, 0.5]):
        seen, reward, terminated, truncated, info = env.step(torch.tensor([action] * 2))
        assert as_numpy(seen) in env.observation_space
        for row in range(2):
            one = {name: part[row] for name, part in as_numpy(seen).items()}
            assert one in env.single_observation_space
        for found, dtype in ((reward, torch.float32), (terminated, torch.bool)):
            assert found.shape == (2,) and found.dtype is dtype
        assert truncated.dtype is torch.bool and info["success"].dtype is torch.bool
    assert seen["wrench"].abs().max() > 1 and not first["wrench"].any()
    assert seen["depth_m"].max() > 1e-4 and seen["traction_pa"].abs().max() > 1e3
    assert seen["contact"].any() and not first["contact"].any()
    assert (seen["rgb"].int() - first["rgb"].int()).abs().max() > 3
    assert env.action_space.shape == (2, 4) and np.zeros((2, 4), "f4") in env.action_space


def _keys(value: object) -> object:
    if isinstance(value, dict):
        return {key: _keys(inner) for key, inner in value.items()}
    return [_keys(inner) for inner in value] if isinstance(value, (list, tuple)) else None


@pytest.mark.parametrize("name", names())
def test_every_task_draws_what_its_file_names_and_steps(name: str) -> None:
    """The file leaves nothing to defaults, which a bare machine does not know."""
    assert _keys(read_toml(FILES / f"{name}.toml")) == _keys(parameters(name).model_dump())
    short = task_with(name, steps=3)
    env = make(short, randomised=True, observe=("wrench", "depth_m", "proprioception"))
    first, _ = env.reset(seed=1)
    assert as_numpy(first) in env.observation_space
    for step in range(1, 4):
        seen, reward, terminated, truncated, info = env.step(torch.ones(env.action_space.shape))
        assert as_numpy(seen) in env.observation_space and torch.isfinite(reward).all()
        assert not terminated.any() and "cause" not in info
        assert truncated.tolist() == [step == 3] * 2, "the time is over with the last step"
    assert not torch.equal(seen["proprioception"], first["proprioception"])


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:.*infinity.*")
@pytest.mark.parametrize(
    ("name", "actions", "options"),
    [
        ("peg-insertion", 4, {"observe": ("wrench", "markers_px", "proprioception")}),
        # Three fingers of three joints.
        ("grasp-lift-hand", 13, {}),
    ],
)
def test_gymnasiums_checkers_pass(name: str, actions: int, options: dict[str, Any]) -> None:
    options |= {"device": "cpu", "randomised": True}
    check_env(TactileEnv(name, **options), skip_render_check=True)
    short = short_task() if actions == 4 else name
    pair = [TactileEnv(short, **options) for _ in range(2)]
    assert pair[0].action_space.shape == (actions,)
    check_environments_match(*pair, num_steps=12 if actions == 4 else 5, seed=3)


def same(found: dict[str, torch.Tensor], wanted: dict[str, np.ndarray]) -> None:
    for name, part in as_numpy(found).items():
        np.testing.assert_allclose(part, wanted[name], rtol=2e-3, atol=2e-3, err_msg=name)


def both(
    mode: AutoresetMode, count: int, seed: int, randomised: bool
) -> tuple[TactileVectorEnv, SyncVectorEnv]:
    task = short_task()
    ours = make(task, count, autoreset_mode=mode, randomised=randomised)
    singles = [lambda: TactileEnv(task, device="cpu", randomised=randomised)] * count
    theirs = SyncVectorEnv(singles, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is mode
    same(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
    return ours, theirs


def step_both(ours: TactileVectorEnv, theirs: SyncVectorEnv, actions: np.ndarray) -> np.ndarray:
    seen, reward, terminated, truncated, info = ours.step(torch.tensor(actions))
    wanted = theirs.step(actions)
    same(seen, wanted[0])
    assert ("final_obs" in info) == ("final_obs" in wanted[4])
    if "final_obs" in info:
        who = wanted[4]["_final_obs"]
        np.testing.assert_array_equal(info["_final_obs"].numpy(), who)
        ended = wanted[4]["final_obs"][who]
        last = {name: np.stack([one[name] for one in ended]) for name in seen}
        same({name: part[torch.tensor(who)] for name, part in info["final_obs"].items()}, last)
    np.testing.assert_allclose(reward.numpy(), wanted[1], rtol=1e-3, atol=1e-4)
    ends = np.stack([terminated.numpy(), truncated.numpy()])
    np.testing.assert_array_equal(ends, wanted[2:4])
    return ends


@pytest.mark.thorough
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_new_episodes_are_those_of_gymnasiums_own_vector_environment(mode: AutoresetMode) -> None:
    ours, theirs = both(mode, 3, 5, True)
    actions = np.array([DOWN, [0.4, 0.1, -0.2, 0.3], [0.0, 0.0, -0.7, 0.0]], dtype=np.float32)
    ends = np.sum([step_both(ours, theirs, actions) for _ in range(18)], axis=0)
    assert ends[0, 0] >= 2 and ends[0, 2] >= 1 and ends[1, 1] >= 2
    assert ends[0, 0] > ends[0, 2]


@pytest.mark.thorough
def test_disabled_is_that_of_gymnasiums_own_vector_environment() -> None:
    ours, theirs = both(AutoresetMode.DISABLED, 2, 1, False)
    actions = np.array([DOWN, [0.0] * 4], dtype=np.float32)
    resets = 0
    for _ in range(14):
        ended = torch.tensor(step_both(ours, theirs, actions).any(axis=0))
        if ended.any():
            with pytest.raises(InputError, match=r"environments \d.* have no episode"):
                ours.step(torch.tensor(actions))
            resets += 1
            wanted_start, _ = theirs.reset(options={"reset_mask": ended.numpy().copy()})
            same(ours.reset(options={"reset_mask": ended})[0], wanted_start)
    assert resets >= 3


def test_a_reset_mask_touches_no_other_environment() -> None:
    env = make(count=3, autoreset_mode=AutoresetMode.DISABLED, randomised=True)
    env.reset(seed=2)
    for _ in range(3):
        seen = env.step(torch.tensor([DOWN] * 3))[0]
    arrays = [env.state.positions, env.state.velocities, env.state.poses]
    parameters = [env.model.pair_friction, env.model.masses, env.model.largest_moduli]
    before = [array.numpy().copy() for array in arrays + parameters]
    after_reset, _ = env.reset(options={"reset_mask": np.array([False, True, False])})
    for old, array in zip(before, arrays + parameters, strict=True):
        new = array.numpy()
        np.testing.assert_array_equal(new[[0, 2]], old[[0, 2]])
        assert not np.array_equal(new[1], old[1])
    for name, part in after_reset.items():
        torch.testing.assert_close(part[[0, 2]], seen[name][[0, 2]], rtol=0, atol=0)
        assert not part[1].any()


def test_actions_end_at_one_rewards_are_depths_that_are_gained_and_episodes_have_whole_times() -> (
    None
):
    """Two gels that go across as far as they can in a step, by 1 and by 9."""
    task = task_with("peg-insertion", steps=2)
    learning, goal_mm = task.parameters.learning, task.parameters.goal.depth_mm
    env = make(task, observe="proprioception")
    for _ in range(2):
        env.reset(seed=4)
        depths = []
        for step in (1, 2):
            actions = torch.tensor([[1.0, 0.0, -1.0, 0.0], [9.0, 0.0, -9.0, 0.0]])
            seen, reward, _, truncated, info = env.step(actions)
            depths.append(info["depth_mm"])
            assert truncated.tolist() == [step == 2] * 2
        moved = task.parameters.dt_s * np.array(learning.speed_mm_s) * [1, 0, -1]
        places = seen["proprioception"]
        np.testing.assert_allclose(places[:, :3], [moved, moved], rtol=1e-6)
        np.testing.assert_allclose(reward, (depths[1] - depths[0]) / goal_mm, atol=1e-5)
        assert env.reset(seed=4)[0]["proprioception"].abs().max() == 0
        env.step(actions)  # One of an episode that is left.


def test_starts_are_drawn_to_both_sides() -> None:
    """The hole, which follows both gels, is put where the start is asked for."""
    env = make(count=6)
    env.reset(seed=1)
    across = env.state.poses.numpy()[:, -1, :2]
    assert (across.min(axis=0) < 0).all() and (across.max(axis=0) > 0).all()


def test_a_simulation_that_fails_ends_with_its_cause() -> None:
    """One Newton iteration does not squeeze a peg; the next step begins anew all the same."""
    env = make(solver={"max_newton_iterations": 1, "max_substep_halvings": 0})
    env.reset(seed=0)
    seen, reward, terminated, truncated, info = env.step(torch.zeros(2, 4))
    assert info["cause"].tolist() == ["NO_CONVERGENCE"] * 2 and info["_cause"].all()
    assert truncated.all() and not terminated.any() and not reward.any()
    assert all(torch.isfinite(part).all() for part in seen.values())
    _, _, terminated, truncated, info = env.step(torch.zeros(2, 4))
    assert "cause" not in info and not (terminated | truncated).any()
    assert "cause" in env.step(torch.zeros(2, 4))[-1]


def test_an_impossible_start_ends_with_its_cause_and_the_others_go_on() -> None:
    """The peg begins 2 mm deep in the block, where there is no room for it 4 mm beside."""
    env = make(task_with("peg-insertion", policy={"peg_mm": (0.0, 0.0, 18.0)}))
    env.reset(seed=0, options={"start": [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]]})
    seen, _, _, truncated, info = env.step(torch.zeros(2, 4))
    assert info["cause"].tolist() == [None, EnvStatus.OVERLAP.name]
    assert info["_cause"].tolist() == truncated.tolist() == [False, True]
    assert not seen["wrench"][1].any()
    assert env.step(torch.zeros(2, 4))[0]["wrench"][0].abs().max() > 1


def test_an_action_that_is_no_number_fails_its_own_environment_alone() -> None:
    env = make()
    env.reset(seed=0)
    half = torch.tensor([[0.0] * 4, [float("nan")] * 4])
    _, reward, _, truncated, info = env.step(half)
    assert truncated.tolist() == [False, True] == info["_cause"].tolist()
    assert info["cause"].tolist() == [None, "NOT_A_NUMBER"]
    seen, *_ = env.step(torch.zeros(2, 4))
    assert all(torch.isfinite(part).all() for part in (reward, *seen.values()))


@pytest.mark.thorough
def test_seeds() -> None:
    """Environment i of seed s does what environment 0 of seed s + i does, in every episode."""

    def episodes(count: int, seed: int) -> list[torch.Tensor]:
        env = make(short_task(steps=3), count, randomised=True)
        env.reset(seed=seed)
        found = []
        for _ in range(8):
            seen = env.step(torch.tensor([DOWN] * count))[0]
            found += [torch.cat([part.flatten(1) for part in seen.values()], dim=1)]
            found += [torch.tensor(env.state.poses.numpy()[:, 2])]
        return found

    pair, again, alone = episodes(2, 7), episodes(2, 7), episodes(1, 8)
    for first, second, one in zip(pair, again, alone, strict=True):
        assert torch.equal(first, second)
        torch.testing.assert_close(first[1:], one, rtol=2e-3, atol=2e-3)
    holes = torch.stack(pair[1::2])
    assert len({tuple(row) for row in holes[:, 0].tolist()}) == 3, "each episode has its own start"
    assert not torch.equal(holes[0, 0], holes[0, 1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"observe": ("smell",)}, r"observe names some of rgb, .*; got smell"),
        ({"autoreset_mode": "NEVER"}, "no autoreset_mode 'NEVER'.*NEXT_STEP, SAME_STEP, DISABLED"),
        ({"arrays": "jax"}, "no arrays 'jax'.*torch, numpy"),
        ({"render_mode": "human"}, "no render_mode 'human'.*rgb_array"),
        ({"task": "juggle"}, r"be learned.*peg-insertion"),
        ({"task": named("ball-rolling")}, r"be learned.*peg-insertion"),
        ({"count": 0}, "num_envs must be at least 1"),
    ],
)
def test_environments_that_cannot_be_made(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make(**options)


def test_bad_resets_and_actions_are_refused() -> None:
    env = make(count=2, autoreset_mode=AutoresetMode.DISABLED)
    with pytest.raises(InputError, match="have no episode"):
        env.step(torch.zeros(2, 4))
    for wrong, message in (
        ({"reset_mask": np.array([0, 1])}, r"reset_mask must be bool of shape \[2\]"),
        ({"reset_mask": np.array([False, False])}, "name an environment"),
        ({"start": [[0.0, 0.0]]}, r"start must have shape \[2, 3\], got \[1, 2\]"),
        ({"pose": 3}, "options are reset_mask and start, got pose"),
    ):
        with pytest.raises(InputError, match=message):
            env.reset(options=wrong)
    env.reset()
    with pytest.raises(InputError, match=r"actions must have shape \[2, 4\], got \[2, 3\]"):
        env.step(torch.zeros(2, 3))


def test_actions_beyond_their_bounds_move_no_further() -> None:
    env = make(observe=("proprioception",))
    env.reset(seed=0)
    action = torch.tensor([[1.0, -1.0, 0.2, 1.0], [9.0, -3.0, 0.2, 1.5]])
    for _ in range(2):
        moved = env.step(action)[0]["proprioception"]
    assert moved[0].abs().min() > 0
    torch.testing.assert_close(moved[1], moved[0], rtol=0, atol=0)
    for _ in range(45):
        env.task.act(torch.tensor([True, True]), action)
    np.testing.assert_allclose(env.task.proprioception()[0], [4, -4, 4.6, 6], atol=1e-9)


HAND = named_robot("three_finger_hand")
STEP = np.full(9, 0.1)
EVERYONE = torch.tensor([True, True])


def attached(control: JointControl, count: int) -> JointControl:
    control.attach(count, "cpu")
    return control


def test_steps_stay_within_limits() -> None:
    control = attached(JointControl(HAND, HAND.rest_q, STEP), 2)
    action = torch.zeros(2, 9, dtype=torch.float64)
    action[0], action[1, 2] = 0.5, -1.0
    for _ in range(40):
        control.act(EVERYONE, action)
    np.testing.assert_allclose(control.q[0], np.tile([0.5, 1.4, 1.6], 3), atol=1e-12)
    assert control.q[1, 2] == -0.3 and not control.q[1, [0, 1, 3, 4, 5, 6, 7, 8]].any()
    np.testing.assert_allclose(control.poses(), HAND.targets(control.q.numpy()), atol=1e-12)
    np.testing.assert_allclose(control.in_mm_and_deg()[1, 2], -np.degrees(0.3))
    assert control.names[:2] == ("spread_1_deg", "knuckle_1_deg")
    before = control.q.clone()
    control.act(torch.tensor([False, True]), -action)
    assert torch.equal(control.q[0], before[0]) and control.q[1, 2] == pytest.approx(-0.2)
    control.begin(torch.tensor([True, False]))
    assert not control.q[0].any() and control.q[1, 2] == pytest.approx(-0.2)


def test_targets_are_approached_at_the_joint_s_speed() -> None:
    gripper, start = named_robot("parallel_gripper"), np.array([0.03])
    control = attached(JointControl(gripper, start, np.array([4e-3]), actions="target"), 1)
    assert control.names == ("slide_left_mm",)
    for wanted in (26, 22, 20, 20):
        control.act(EVERYONE[:1], torch.tensor([[0.0]]))
        assert control.in_mm_and_deg().item() == pytest.approx(wanted, abs=1e-9)
    near = JointControl(gripper, start, np.array([1.0]), actions="target", reach=np.array([5e-3]))
    attached(near, 1)
    for action, wanted in ((-1.0, 25.0), (1.0, 35.0)):
        near.act(EVERYONE[:1], torch.tensor([[action]]))
        assert near.in_mm_and_deg().item() == pytest.approx(wanted)


def test_nothing_is_read_from_the_device() -> None:
    """Tensors on torch's device "meta" have no values: whatever asks for one fails."""
    control = JointControl(HAND, HAND.rest_q, STEP, actions="target")
    control.attach(4, "meta")
    who = torch.ones(4, dtype=torch.bool, device="meta")
    control.begin(who)
    control.act(who, torch.zeros((4, 9), device="meta"))
    assert control.poses().shape == (4, len(HAND.kinematic_bodies()), 7)


def test_what_cannot_be_controlled_is_refused() -> None:
    with pytest.raises(InputError, match=r"coordinate 2 of joint 'spread_1' .* out of its limits"):
        JointControl(HAND, np.full(9, 2.0), STEP)
    free = replace(HAND.joints[0], lower=-np.inf, upper=np.inf)
    endless = replace(HAND, joints=(free, *HAND.joints[1:]))
    with pytest.raises(InputError, match="joint 'spread_1' has no limits that a target could lie"):
        JointControl(endless, HAND.rest_q, STEP, actions="target")
    JointControl(endless, HAND.rest_q, STEP, actions="target", reach=np.full(9, 0.5))


def test_an_environment_takes_targets() -> None:
    task = task_with("grasp-lift-hand", learning={"joint_actions": "target"})
    env = make(task, 1, observe=("proprioception",))
    first = env.reset(seed=0)[0]["proprioception"][0]
    action = torch.zeros(1, 13)
    action[0, 5], action[0, 6] = 1.0, -1.0
    for _ in range(3):
        seen = env.step(action)[0]["proprioception"][0]
    step = 3 * parameters("grasp-lift-hand").learning.joint_speed * task.parameters.dt_s
    np.testing.assert_allclose((seen - first)[5:7], [step, -step], atol=1e-3)
