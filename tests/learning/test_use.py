# SPDX-License-Identifier: Apache-2.0
"""What strangers do with environments: sensors by name, actions of a policy, use after an end."""

from __future__ import annotations

import weakref
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

from taccel_lab.errors import InputError
from taccel_lab.learning.catalogue import make_vec
from taccel_lab.learning.peg_insertion import PegInsertionLearning
from taccel_lab.learning.vector_env import TactileVectorEnv
from taccel_lab.profile import save_profile
from taccel_lab.registration import env_id
from taccel_lab.sensors.profile import stock_sensor
from tests.tasks.changed import parameters, task_with

PEG = env_id("peg-insertion")


def make(count: int = 2, **options: Any) -> TactileVectorEnv:
    return make_vec("peg-insertion", count, device="cpu", **options)


def test_a_sensor_is_given_by_its_name_or_folder_and_has_its_own_colours(tmp_path: Path) -> None:
    """Images of untouched gels are the profile's own."""

    def images(sensor: Any) -> np.ndarray:
        env = make(1, observe="rgb", sensor=sensor, arrays="numpy")
        return env.reset(seed=0)[0]["rgb"].astype(int)

    mini = stock_sensor("gelsight_mini")
    assert mini.background_rgb is not None
    other = replace(mini, background_rgb=mini.background_rgb[..., ::-1])
    save_profile(other, tmp_path / "other")
    named, swapped = images("gelsight_mini"), images(tmp_path / "other")
    assert np.abs(named - swapped).mean() > 20
    # Colours are rounded once more where an image is drawn.
    np.testing.assert_allclose(swapped, named[..., ::-1], atol=1)
    with pytest.raises(InputError, match=r"did you mean gelsight_mini\?"):
        make(sensor="gelsight_minu")
    with pytest.raises(InputError, match="sensor is a profile, its folder or a name, got 3"):
        make(sensor=3)


def test_a_task_of_ones_own_is_drawn_too() -> None:
    task = PegInsertionLearning(parameters("peg-insertion"), 1)
    env = TactileVectorEnv(task, device="cpu", render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render()[0].shape == (240, 640, 3)


def test_nothing_touched_reads_as_nothing() -> None:
    """The gels close in front of a peg that is 60 mm below them, and are not moved."""
    below = task_with("peg-insertion", policy={"peg_mm": (0.0, 0.0, -60.0)})
    env = make_vec(below, 2, device="cpu", observe=("wrench", "rgb", "contact"), arrays="numpy")
    first, _ = env.reset(seed=0)
    seen, *_, info = env.step(np.zeros((2, 4), np.float32))
    assert "cause" not in info
    assert not seen["wrench"].any() and not seen["contact"].any()
    assert np.abs(seen["rgb"].astype(int) - first["rgb"]).max() <= 1


def test_actions_with_a_gradient_are_actions() -> None:
    env = make()
    env.reset(seed=0)
    policy = torch.nn.Linear(4, 4)
    wanted = env.step(policy(torch.ones(2, 4)).detach())[0]
    env.reset(seed=0)
    found = env.step(policy(torch.ones(2, 4)))[0]
    for name, part in wanted.items():
        assert torch.equal(found[name], part) and not found[name].requires_grad


def test_a_closed_environment_is_refused_and_gives_its_memory_back() -> None:
    env = make(1, render_mode="rgb_array")
    env.reset(seed=0)
    state = weakref.ref(env.state)
    env.close()
    env.close()
    assert state() is None
    single = gymnasium.make(PEG, device="cpu").unwrapped
    single.reset(seed=0)
    single.close()
    single.close()
    for use in (
        lambda: env.step(torch.zeros(1, 4)),
        env.reset,
        env.render,
        lambda: single.step(np.zeros(4)),
    ):
        with pytest.raises(InputError, match="the environment is closed"):
            use()


def test_a_mode_may_be_given_by_its_name() -> None:
    env = make(autoreset_mode="SAME_STEP")
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    env.reset(seed=0)
    info = env.step(torch.tensor([[0.0] * 4, [np.nan] * 4]))[-1]
    assert info["_final_obs"].tolist() == [False, True]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 2.5}, "num_envs must be a whole number, got 2.5"),
        ({"count": "4"}, "num_envs must be a whole number, got '4'"),
        ({"observe": ("wrnch",)}, r"got wrnch \(did you mean wrench\?\)"),
        ({"randomised": "yes"}, "randomised is True, False or ranges .*, got 'yes'"),
        ({"randomised": {"friction": 0.5}}, r"range of friction must be \(low, high\), got 0.5"),
        ({"solver": {"max_newton": 3}}, r"did you mean max_newton_iterations\?"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make(**options)


def test_options_of_vector_environments_are_not_of_one() -> None:
    with pytest.raises(InputError, match=r"autoreset_mode: only of vector environments"):
        gymnasium.make(PEG, device="cpu", autoreset_mode=AutoresetMode.SAME_STEP)
