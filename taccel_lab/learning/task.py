# SPDX-License-Identifier: Apache-2.0
"""``LearningTask``: what a task says to be learned. The vector environment does the rest.

Everything that changes is a torch tensor on the solver's device with a row for each environment.
Whatever differs between starts is a pose of kinematic bodies: free bodies begin where the scene has
them, as only relative places matter.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import torch

from taccel_lab.learning.ranges import DrawnRange, Given, ranges_of
from taccel_lab.model import Model
from taccel_lab.scene import Scene
from taccel_lab.solvers import SolverConfig
from taccel_lab.state import State

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile
    from taccel_lab.tasks.parameters import Randomised


@dataclass(frozen=True)
class Judgement:
    """What came of a step, a row for each environment."""

    reward: torch.Tensor
    """float32, [env]."""
    success: torch.Tensor
    """Whether the criterion is met, which ends the episode; bool, [env]."""
    figures: dict[str, torch.Tensor]
    """What else goes into ``info``, by names that end in units, float32, [env]."""


class LearningTask(ABC):
    """A task of some environments."""

    start_names: ClassVar[tuple[str, ...]]
    """What a start draws, with units."""
    action_names: tuple[str, ...]
    """What the entries of an action move; each lies in [-1, 1]."""
    proprioception_names: tuple[str, ...]
    """What the robot knows of itself, with units."""

    scene: Scene
    config: SolverConfig
    step_limit: int
    """Steps after which an episode is truncated."""
    start_half: tuple[float, ...]
    """Half ranges of the starts, by ``start_names``."""
    randomised: tuple[Randomised, ...]
    """Parameters that episodes may draw, of the file."""

    @abstractmethod
    def __init__(
        self, parameters: Any, env_count: int, sensor: SensorProfile | None = None
    ) -> None:
        """
        Args:
            parameters: Of the task's file, by attributes.
            env_count: Environments of the scene.
            sensor: Whose gels stand in place of the file's.

        Raises:
            InputError: A sensor, of a task whose gels are part of it.
        """

    def ranges(self, given: Given) -> tuple[DrawnRange, ...]:
        """What episodes draw, with ranges that are given in place of others; see ``ranges_of``."""
        return ranges_of(self.randomised, given)

    @abstractmethod
    def attach(self, model: Model, state: State) -> None:
        """Make the tensors, on the device of the model; ``state`` is stepped in place."""

    @abstractmethod
    def begin(self, who: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
        """Put the environments of ``who`` (bool, [env]) to a start (float64, [env, start_names]).

        Returns the poses of the kinematic bodies [env, kinematic, 7], float64: x, y, z [m],
        quaternion x, y, z, w; those of other environments are where they are.
        """

    @abstractmethod
    def act(self, who: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Poses, as of ``begin``, at the end of the next step of the environments of ``who``, which
        take an action in [-1, 1], float64, [env, action_names]."""

    @abstractmethod
    def judge(self) -> Judgement:
        """Look at the step that was taken."""

    @abstractmethod
    def proprioception(self) -> torch.Tensor:
        """What the robot knows of itself, [env, proprioception_names]."""
