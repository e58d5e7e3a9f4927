# SPDX-License-Identifier: Apache-2.0
"""Tasks by gymnasium's own call."""

from __future__ import annotations

import gymnasium
import pytest

from taccel_lab.errors import InputError
from taccel_lab.learning.catalogue import names
from taccel_lab.learning.gymnasium_envs import env_id
from taccel_lab.learning.vector_env import TactileVectorEnv


def test_every_task_is_registered() -> None:
    assert {f"taccel_lab/{env_id(task)}" for task in names()} <= set(gymnasium.registry)
    assert env_id("peg-insertion") == "PegInsertion-v0"


def test_gymnasium_makes_ours() -> None:
    env = gymnasium.make_vec("taccel_lab/PegInsertion-v0", num_envs=2, device="cpu")
    assert isinstance(env, TactileVectorEnv) and env.num_envs == 2
    with pytest.raises(InputError, match="num_envs must be at least 1"):
        gymnasium.make_vec("taccel_lab/PegInsertion-v0", num_envs=0)
