# SPDX-License-Identifier: Apache-2.0
"""One environment of a vector environment as a ``gymnasium.Env`` of numpy arrays, for gymnasium's
own checkers and its own vector environments; changed copies of the peg insertion."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode

from taccel_lab.learning.catalogue import make_vec
from taccel_lab.tasks.catalogue import Task
from tests.tasks.changed import task_with


def as_numpy(observation: dict[str, torch.Tensor]) -> dict[str, np.ndarray]:
    return {name: part.numpy() for name, part in observation.items()}


class SingleEnv(gymnasium.Env):
    """Resets are left to whoever steps it."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, task: Any, **options: Any) -> None:
        mode = AutoresetMode.DISABLED
        self._vector = make_vec(task, 1, autoreset_mode=mode, device="cpu", **options)
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        super().reset(seed=seed)
        observation, _ = self._vector.reset(seed=seed, options=options)
        return {name: part[0] for name, part in as_numpy(observation).items()}, {}

    def step(
        self, action: np.ndarray
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        seen, reward, terminated, truncated, info = self._vector.step(torch.as_tensor(action)[None])
        observation = {name: part[0] for name, part in as_numpy(seen).items()}
        figures = {name: float(info[name][0]) for name in info if name.endswith("_mm")}
        return observation, float(reward[0]), bool(terminated[0]), bool(truncated[0]), figures


def short_task(steps: int = 7) -> Task:
    """Episodes of a few steps: a peg that goes down at once succeeds in the fifth."""
    return task_with("peg-insertion", steps=steps, goal={"depth_mm": 0.5})
