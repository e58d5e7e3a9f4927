# SPDX-License-Identifier: Apache-2.0
"""One environment of a task as a ``gymnasium.Env`` of numpy arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from taccel_lab.errors import InputError
from taccel_lab.learning.catalogue import make_vec
from taccel_lab.learning.gymnasium_names import AutoresetMode, Env
from taccel_lab.learning.vector_env import RENDER_MODES

if TYPE_CHECKING:
    from taccel_lab.tasks.catalogue import Task


class TactileEnv(Env[dict[str, np.ndarray], np.ndarray]):
    """A ``TactileVectorEnv`` of one environment; whoever steps it resets it.

    ``info`` has the task's figures, ``success`` and, where the simulation failed, its ``cause``.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    def __init__(self, task: str | Task, **options: Any) -> None:
        """Options as of ``make_vec``, but how episodes begin anew and what arrays are.

        Raises InputError for these, and as of ``make_vec``.
        """
        if fixed := sorted({"arrays", "autoreset_mode", "num_envs"} & set(options)):
            raise InputError(
                f"{', '.join(fixed)}: only of vector environments (gymnasium.make_vec); whoever "
                "steps this one resets it, and gets numpy's arrays"
            )
        self._vector = make_vec(
            task, 1, autoreset_mode=AutoresetMode.DISABLED, arrays="numpy", **options
        )
        self.metadata = {**self.metadata, "render_fps": self._vector.metadata["render_fps"]}
        self.render_mode = self._vector.render_mode
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """See ``TactileVectorEnv.reset``."""
        super().reset(seed=seed)
        seen, info = self._vector.reset(seed=seed, options=options)
        return _first(seen), _first(info)

    def step(
        self, action: np.ndarray
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """See ``TactileVectorEnv.step``; an action in [-1, 1], [action]."""
        seen, reward, terminated, truncated, info = self._vector.step(torch.as_tensor(action)[None])
        ends = bool(terminated[0]), bool(truncated[0])
        return _first(seen), float(reward[0]), *ends, _first(info)

    def render(self) -> np.ndarray | None:
        """A picture, see ``EnvPicture``."""
        images = self._vector.render()
        return None if images is None else images[0]

    def close(self) -> None:
        """Let the device's memory go."""
        self._vector.close()


def _first(rows: dict[str, Any]) -> dict[str, Any]:
    """The row of the one environment, without masks."""
    return {
        name: row[0] if row[0] is None or isinstance(row[0], (np.ndarray, str)) else row[0].item()
        for name, row in rows.items()
        if not name.startswith("_")
    }
