# SPDX-License-Identifier: Apache-2.0
"""The peg insertion of ``tasks.peg_insertion``, to be learned: same scene, starts and criterion.

There gels and peg start off the hole; here the hole is moved by the inverse, which is the same
relative start. Both gels close in the first step, as the baseline's do, and an action moves them
together: three ways and a turn about the vertical through the middle between them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
import warp as wp

from taccel_lab.learning.task import Judgement, LearningTask, about_z, compose, planar_inverse
from taccel_lab.model import Model
from taccel_lab.scene import Element
from taccel_lab.state import State
from taccel_lab.tasks.bodies import SIDES, contact_config, sensor_gel
from taccel_lab.tasks.peg_scene import TURNS, PegPath, face_offset, peg_parts, peg_scene

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile
    from taccel_lab.tasks.peg_insertion import PegInsertionParameters

SUCCESS_REWARD = 1.0
"""Reward beside the part of the depth that each step gains."""


class PegInsertionLearning(LearningTask):
    """Peg insertion of some environments."""

    start_names = ("x_mm", "y_mm", "yaw_deg")
    action_names = ("x", "y", "z", "yaw")
    proprioception_names = ("x_mm", "y_mm", "z_mm", "yaw_deg")

    def __init__(
        self,
        parameters: PegInsertionParameters,
        env_count: int,
        sensor: SensorProfile | None = None,
    ) -> None:
        start, policy, learning = parameters.start, parameters.policy, parameters.learning
        parts, _ = peg_parts(parameters.meshes)
        path = PegPath.of_mm(policy.peg_mm, policy.times_s, policy.gel_mm)
        gel = None if sensor is None else sensor_gel(sensor, element=Element.LINEAR)
        self.scene = peg_scene(parts, path, env_count, dt_s=parameters.dt_s, gel=gel)
        self._out_m = 0.0 if gel is None else face_offset(parts, gel)
        self.sensor, self.gels = sensor, SIDES
        self.config = contact_config(parameters.contact)
        self.step_limit = parameters.steps
        self.start_half = (start.x_mm, start.y_mm, start.yaw_deg)
        self.randomised = tuple(learning.randomise)
        self._path = path
        self._goal_m = 1e-3 * parameters.goal.depth_mm
        self._rim_m = float(parts.hole.vertices_m[:, 2].max())
        per_step = [*(1e-3 * s for s in learning.speed_mm_s), np.radians(learning.turn_deg_s)]
        self._per_step = parameters.dt_s * np.array(per_step)
        self._reach = np.array(
            [*(1e-3 * reach for reach in learning.reach_mm), np.radians(learning.reach_deg)]
        )

    def attach(self, model: Model, state: State) -> None:
        count, device = model.env_count, wp.device_to_torch(model.device)

        def put(values: np.ndarray) -> torch.Tensor:
            return torch.tensor(values, dtype=torch.float64, device=device)

        self._state = state
        self._peg = model.bodies[model.body_id("peg")].node_slice
        self._step_size, self._most = put(self._per_step), put(self._reach)
        # Of both gels in the frame between them, open and closed.
        apart = np.zeros((2, 2, 3))
        apart[..., 0] = np.outer(self._path.gel_m[[0, -1], 0] + self._out_m, [-1, 1])
        turns = np.broadcast_to(TURNS, (2, 2, 4))
        self._gels = put(np.concatenate([apart, turns], axis=2))
        self._middle = put(self._path.gel_m[0] * [0, 1, 1])
        self._moved = put(np.zeros((count, 4)))
        """Motion of the middle between the gels [m], and their turn [rad], since the start."""
        self._closed = torch.zeros(count, dtype=torch.long, device=device)
        self._hole = put(np.tile([0.0, 0, 0, 0, 0, 0, 1], (count, 1)))
        self._depth = put(np.zeros(count))

    def begin(self, who: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
        """The hole goes to where the start of gels and peg is the one that is requested."""
        self._hole = torch.where(who[:, None], planar_inverse(start), self._hole)
        self._moved = torch.where(who[:, None], 0.0, self._moved)
        self._closed = torch.where(who, 0, self._closed)
        self._depth = torch.where(who, self._rim_m - self._path.peg_m[2], self._depth)
        return self._poses()

    def act(self, who: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        moved = self._moved + self._step_size * action
        moved = torch.minimum(torch.maximum(moved, -self._most), self._most)
        # The gels close first.
        self._moved = torch.where((who & (self._closed > 0))[:, None], moved, self._moved)
        self._closed = torch.where(who, 1, self._closed)
        return self._poses()

    def _poses(self) -> torch.Tensor:
        middle = self._middle + self._moved[:, :3]
        base = torch.cat([middle, about_z(self._moved[:, 3])], dim=1)
        gels = compose(base[:, None], self._gels[self._closed])
        return torch.cat([gels, self._hole[:, None]], dim=1)

    def judge(self) -> Judgement:
        """The reward is the part of the asked depth that the step gained, and 1 for success."""
        positions = wp.to_torch(self._state.positions, requires_grad=False)
        depth = self._rim_m - positions[:, self._peg, 2].amin(dim=1)
        gained = (depth - self._depth) / self._goal_m
        self._depth = depth
        success = depth >= self._goal_m
        reward = gained + SUCCESS_REWARD * success
        return Judgement(reward.float(), success, {"depth_mm": 1e3 * depth.float()})

    def proprioception(self) -> torch.Tensor:
        place, yaw = 1e3 * self._moved[:, :3], torch.rad2deg(self._moved[:, 3:])
        return torch.cat([place, yaw], dim=1)
