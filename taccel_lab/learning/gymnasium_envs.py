# SPDX-License-Identifier: Apache-2.0
"""Tasks as environments that gymnasium knows; importing this module registers them.

>>> import gymnasium
>>> name = "taccel_lab.learning.gymnasium_envs:taccel_lab/PegInsertion-v0"
>>> env = gymnasium.make_vec(name, num_envs=64)    # doctest: +SKIP

gymnasium imports the module before the colon; it has read no entry points of packages since 1.1.
"""

from __future__ import annotations

from typing import Any

from taccel_lab.learning.catalogue import make_vec, names
from taccel_lab.learning.gymnasium_names import register
from taccel_lab.learning.vector_env import TactileVectorEnv

NAMESPACE = "taccel_lab"
_PACKAGE = "taccel_lab.learning.gymnasium_envs"


def env_id(task: str) -> str:
    """``PegInsertion-v0`` of ``peg-insertion``."""
    return "".join(word.capitalize() for word in task.split("-")) + "-v0"


def register_envs() -> None:
    """Register every task that can be learned, in the namespace of the package."""
    for task in names():
        register(
            f"{NAMESPACE}/{env_id(task)}",
            vector_entry_point=f"{_PACKAGE}:make_registered",
            kwargs={"task": task},
        )


def make_registered(num_envs: int = 1, *, task: str, **options: Any) -> TactileVectorEnv:
    """What ``gymnasium.make_vec`` calls; options as of ``learning.catalogue.make_vec``."""
    return make_vec(task, num_envs, **options)


register_envs()
