# SPDX-License-Identifier: Apache-2.0
"""``LearningTask``: what a task says to be learned. The vector environment does the rest.

Everything that changes is a torch tensor on the solver's device with a row for each environment.
Whatever differs between starts is a pose of kinematic bodies: free bodies begin where the scene has
them, as only relative places matter. Poses are x, y, z [m], quaternion x, y, z, w on the last axis.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import torch

from taccel_lab.learning.ranges import DrawnRange, Given, ranges_of, sensor_ranges
from taccel_lab.model import Model
from taccel_lab.scene import Scene
from taccel_lab.solvers import SolverConfig
from taccel_lab.state import State

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile
    from taccel_lab.tasks.parameters import Randomised


def about_z(angle: torch.Tensor) -> torch.Tensor:
    """Quaternions of turns about z [rad], [..., 4]."""
    zero = torch.zeros_like(angle)
    return torch.stack([zero, zero, torch.sin(angle / 2), torch.cos(angle / 2)], dim=-1)


def rotated(turn: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
    """Vectors [..., 3] turned by quaternions [..., 4]."""
    axis, vector = torch.broadcast_tensors(turn[..., :3], vector)
    once = 2 * torch.cross(axis, vector, dim=-1)
    return vector + turn[..., 3:] * once + torch.cross(axis, once, dim=-1)


def compose(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """The second pose, given in the frame of the first, in that frame's own frame."""
    p, q = first[..., 3:6], first[..., 6:]
    u, w = second[..., 3:6], second[..., 6:]
    p_, u_ = torch.broadcast_tensors(p, u)
    place = first[..., :3] + rotated(first[..., 3:], second[..., :3])
    imaginary = q * u + w * p + torch.cross(p_, u_, dim=-1)
    return torch.cat([place, imaginary, q * w - (p_ * u_).sum(dim=-1, keepdim=True)], dim=-1)


def planar_inverse(start: torch.Tensor) -> torch.Tensor:
    """Inverse poses of places in the plane, x [mm], y [mm] and turn about z [degrees], [env, 3]."""
    yaw = torch.deg2rad(start[:, 2])
    back = about_z(-yaw)
    place = torch.cat([-1e-3 * start[:, :2], torch.zeros_like(start[:, :1])], dim=1)
    return torch.cat([rotated(back, place), back], dim=1)


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
    sensor: SensorProfile | None
    """Whose gels stand in place of the file's."""
    gels: tuple[str, ...]
    """Names of the gels."""

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
            InputError: A sensor whose gel has layers of several materials.
        """

    def ranges(self, given: Given) -> tuple[DrawnRange, ...]:
        """What episodes draw, with ranges that are given in place of others; see ``ranges_of``
        and, with a sensor, ``sensor_ranges``."""
        if self.sensor is None:
            return ranges_of(self.randomised, given)
        return sensor_ranges(self.randomised, self.sensor, self.gels, self.scene, given)

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
