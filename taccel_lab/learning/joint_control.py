# SPDX-License-Identifier: Apache-2.0
"""Joints of a robot as actions: its links follow their targets exactly (kinematic control)."""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch

from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError
from taccel_lab.robots import Robot

JointActions = Literal["delta", "target"]


class JointControl:
    """Coordinates of a robot in some environments, and the poses of its bodies there.

    An action has an entry for each coordinate, in the order of ``robot.dof_names``. ``delta``: 1 is
    one step at the joint's speed. ``target``: -1 to 1 is the joint's smallest to largest
    coordinate, approached at its speed at most. Nothing waits for the device.
    """

    def __init__(
        self,
        robot: Robot,
        start_q: np.ndarray,
        step: np.ndarray,
        *,
        actions: JointActions = "delta",
        reach: np.ndarray | None = None,
    ) -> None:
        """
        Args:
            robot: Its ``kinematic_bodies`` stand in the scene.
            start_q: Where episodes begin, [dof].
            step: How far a joint moves in a step at most [rad or m], [dof].
            actions: What they mean.
            reach: How far from its start a joint may go [rad or m], [dof]; None leaves it to the
                limits of the robot.

        Raises:
            InputError: A start out of the limits; targets of a joint without limits.
        """
        self.robot = robot
        robot.targets(start_q)  # Refuses coordinates out of the limits.
        low, high = robot.limits.T
        if reach is not None:
            low, high = np.maximum(low, start_q - reach), np.minimum(high, start_q + reach)
        endless = [
            name
            for name, *ends in zip(robot.dof_names, low, high, strict=True)
            if not np.isfinite(ends).all()
        ]
        if actions == "target" and endless:
            raise InputError(
                f"joint {endless[0]!r} has no limits that a target could lie between: give it a "
                "reach, or use delta actions"
            )
        self._actions = actions
        self._values = np.stack([start_q, low, high, step])
        kinds = {joint.name: joint.kind for joint in robot.joints}
        slides = [kinds[name] is JointKind.PRISMATIC for name in robot.dof_names]
        self.names = tuple(
            f"{name}_{'mm' if slide else 'deg'}"
            for name, slide in zip(robot.dof_names, slides, strict=True)
        )
        """Of the coordinates as ``told``."""
        self._shown = np.where(slides, 1e3, np.degrees(1.0))

    def attach(self, env_count: int, device: torch.device | str) -> None:
        """Make the tensors of so many environments, all at the start."""
        values = torch.tensor(self._values, dtype=torch.float64, device=device)
        self._start, self._low, self._high, self._step = values
        self._scale = torch.tensor(self._shown, dtype=torch.float64, device=device)
        self.q = self._start.repeat(env_count, 1)
        """Coordinates [rad or m], float64, [env, dof]."""

    def begin(self, who: torch.Tensor) -> None:
        """The environments of ``who`` (bool, [env]) are at the start again."""
        self.q = torch.where(who[:, None], self._start, self.q)

    def act(self, who: torch.Tensor, action: torch.Tensor) -> None:
        """Move the environments of ``who`` by actions in [-1, 1], [env, dof]."""
        if self._actions == "target":
            wanted = self._low + (self._high - self._low) * (action + 1) / 2
            change = torch.minimum(torch.maximum(wanted - self.q, -self._step), self._step)
        else:
            change = self._step * action
        moved = torch.minimum(torch.maximum(self.q + change, self._low), self._high)
        self.q = torch.where(who[:, None], moved, self.q)

    def poses(self) -> torch.Tensor:
        """Of ``robot.kinematic_bodies``, [env, body, 7]."""
        return self.robot.targets(self.q, check=False)

    def in_mm_and_deg(self) -> torch.Tensor:
        """Coordinates in mm and degrees, [env, dof]."""
        return self.q * self._scale
