# SPDX-License-Identifier: Apache-2.0
"""Tasks by gymnasium's own calls and under its own wrappers."""

from __future__ import annotations

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import (
    FlattenObservation,
    NormalizeObservation,
    NormalizeReward,
    RecordEpisodeStatistics,
)

from taccel_lab.errors import InputError
from taccel_lab.learning.vector_env import TactileVectorEnv
from taccel_lab.registration import env_id, names

PEG = env_id("peg-insertion")
STILL = np.zeros((2, 4), np.float32)
FOUND = """
import importlib.resources, inspect, pkgutil
source = inspect.getsource(gymnasium)
assert pkgutil.get_data("gymnasium", "__init__.py").decode() == source
assert (importlib.resources.files("gymnasium") / "__init__.py").read_text() == source
assert gymnasium.__spec__.loader.get_data(gymnasium.__file__).decode() == source
assert type(gymnasium.__loader__) is type(pkgutil.__loader__)
"""


@pytest.mark.parametrize("modules", ["gymnasium, taccel_lab", "taccel_lab, gymnasium"])
def test_every_task_is_registered_whichever_package_loads_first(modules: str) -> None:
    """And gymnasium's sources and data files are found as without ours."""
    first, second = modules.split(", ")
    asked = "import importlib.util; importlib.util.find_spec('gymnasium')"
    code = f"import {first}; {asked}; import {second}\n{FOUND}\nprint(*sorted(gymnasium.registry))"
    listed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert {env_id(task) for task in names()} <= set(listed.stdout.split())
    lifts = ["grasp-lift", *(f"grasp-lift-{what}" for what in ("ball", "cylinder", "hand"))]
    assert names() == [*lifts, "peg-insertion"] and PEG == "taccel_lab/PegInsertion-v0"


@pytest.mark.thorough
def test_a_name_with_its_module_needs_no_import() -> None:
    code = f"import gymnasium; print(gymnasium.make('taccel_lab:{PEG}', device='cpu').spec.id)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split()[-1] == PEG


def test_make_gives_one_environment_of_arrays_and_its_picture() -> None:
    env = gymnasium.make(PEG, device="cpu", render_mode="rgb_array")
    assert env.metadata["render_fps"] == 50
    seen, _ = env.reset(seed=3)
    assert seen in env.observation_space
    untouched = env.render()
    assert untouched.shape == (240, 320 + 2 * 160, 3) and untouched.dtype == np.uint8
    assert (untouched[120:, 320:] == 128).all(), "no change of the images"
    blue, orange = (untouched[:, :320] @ sign > 40 for sign in ([-1, 0, 1], [1, 0, -1]))
    assert min(blue.sum(), orange.sum()) > 1000, "gels and peg are seen"
    _, reward, terminated, truncated, info = env.step(np.zeros(4, np.float32))
    assert (terminated, truncated) == (False, False) and isinstance(reward, float)
    assert info["success"] is False and isinstance(info["depth_mm"], float)
    change = np.abs(env.render().astype(int) - untouched)
    assert min(change[120:, 320:480].max(), change[120:, 480:].max()) > 40, "both gels are squeezed"
    *_, truncated, info = env.step(np.full(4, np.nan, np.float32))
    assert truncated and info["cause"] == "NOT_A_NUMBER"


def test_make_vec_gives_ours() -> None:
    env = gymnasium.make_vec(PEG, num_envs=2, device="cpu")
    assert isinstance(env, TactileVectorEnv) and env.num_envs == 2 and env.render() is None
    with pytest.raises(InputError, match="num_envs must be at least 1"):
        gymnasium.make_vec(PEG, num_envs=0)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_gymnasiums_statistics_and_normalised_rewards(mode: AutoresetMode) -> None:
    """The second environment ends in its second step; its third step is of a new episode, unless
    that only begins one."""
    inner = gymnasium.make_vec(PEG, num_envs=2, device="cpu", arrays="numpy", autoreset_mode=mode)
    env = NormalizeReward(RecordEpisodeStatistics(inner))
    env.reset(seed=1)
    first = env.step(STILL)
    assert isinstance(first[1], np.ndarray) and "episode" not in first[4]
    ends = np.array([[0.0] * 4, [np.nan] * 4], np.float32)
    info = env.step(ends)[4]
    assert info["episode"]["l"].tolist() == [0, 2] and info["_episode"].tolist() == [False, True]
    env.step(STILL)
    env.step(STILL)
    again = env.step(ends)[4]["episode"]
    assert again["l"].tolist() == [0, 2 if mode is AutoresetMode.NEXT_STEP else 3]


def test_normalised_observations_are_those_of_a_flat_space() -> None:
    inner = gymnasium.make_vec(PEG, num_envs=2, device="cpu", arrays="numpy")
    env = NormalizeObservation(FlattenObservation(inner))
    env.reset(seed=1)
    seen, *_ = env.step(STILL)
    assert seen.shape == (2, 2 * 6 + 4) and np.isfinite(seen).all()
