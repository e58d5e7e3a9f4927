# SPDX-License-Identifier: Apache-2.0
"""Roll a ball, between a gel above and a plane below, to a place.

Where nothing slips, a ball goes half as far as what rolls it: the policy presses the gel on it,
moves the gel by twice the way to the goal and stops. It sees neither that the gel shears nor that
the ball was not under the middle of the gel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from taccel_lab.files.strict_model import StrictModel
from taccel_lab.robots.transforms import rotation_vector
from taccel_lab.scene import (
    KinematicBody,
    Plane,
    Scene,
    TimeStepping,
    sphere_mesh,
)
from taccel_lab.solvers import Control
from taccel_lab.tasks.bodies import G, contact_config, free_body, pad_body, pad_mesh
from taccel_lab.tasks.draw import draw
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.parameters import (
    Contact,
    FreeBody,
    NotNegative,
    PadParameters,
    Positive,
    TaskParameters,
)


class RollingBall(FreeBody):
    """What rolls."""

    radius_mm: Positive
    edge_mm: Positive
    """Length of its triangles' edges."""


class BallStart(StrictModel):
    """Half ranges of the ball's place, from under the gel's middle, and of the goal, from the ball;
    each in x and in y."""

    ball_mm: NotNegative
    goal_mm: NotNegative


class BallPolicy(StrictModel):
    """The scripted baseline."""

    gap_mm: Positive
    """Height of the gel over the ball at the start."""
    depth_mm: Positive
    """Depth by which the gel is pressed on the ball."""
    press_mm_s: Positive
    roll_mm_s: Positive


class BallGoal(StrictModel):
    """When it is done."""

    distance_mm: Positive
    """Distance of the ball's centre from the goal, in the plane."""


class BallRollingParameters(TaskParameters):
    """The file of a ball rolling."""

    kind: Literal["ball-rolling"]
    plane_friction: NotNegative
    ball: RollingBall
    gel: PadParameters
    contact: Contact
    start: BallStart
    policy: BallPolicy
    goal: BallGoal


class BallRolling(TaskEpisode):
    """Ball rolling of some seeds."""

    gel = "gel"

    def __init__(
        self, parameters: BallRollingParameters, seeds: Sequence[int], device: str | None = None
    ) -> None:
        self.parameters = parameters
        count, half = len(seeds), parameters.start
        ranges = {
            "goal_x_mm": half.goal_mm,
            "goal_y_mm": half.goal_mm,
            "ball_x_mm": half.ball_mm,
            "ball_y_mm": half.ball_mm,
        }
        starts = [draw(seed, ranges) for seed in seeds]
        self._goal = 1e-3 * np.array([[s["goal_x_mm"], s["goal_y_mm"]] for s in starts])
        self._place = 1e-3 * np.array([[s["ball_x_mm"], s["ball_y_mm"]] for s in starts])
        radius = 1e-3 * parameters.ball.radius_mm
        shape = sphere_mesh(radius, 1e-3 * parameters.ball.edge_mm)
        pose = np.zeros((count, 7))
        pose[:, :2], pose[:, 6] = self._place, 1.0
        pose[:, 2] = radius + 1e-3 * parameters.contact.dhat_mm
        mesh = pad_mesh(parameters.gel)
        scene = Scene(
            pad_body(parameters.gel, mesh, name="gel", mount="mount"),
            KinematicBody(None, name="mount"),
            count,
            TimeStepping(False, parameters.dt_s, (0.0, 0.0, -G)),
            affine_bodies=free_body(parameters.ball, shape, "ball", pose),
            planes=Plane(friction_coefficient=parameters.plane_friction),
        )
        self._top = pose[0, 2] + radius
        self._down = np.zeros(count)
        """How far the gel has come down [m]."""
        self._travel = np.zeros(count)
        """How far it has gone along its way [m]."""
        super().__init__(
            parameters,
            seeds,
            starts,
            scene,
            contact_config(parameters.contact),
            self._targets(),
            device,
        )
        self._distance = np.full(count, np.nan)
        self._moved = np.full((count, 2), np.nan)
        self._slip = np.full(count, np.nan)
        self._force = np.zeros(count)
        self._strongest = np.zeros(count)
        self._axes = self.affine_frame()[1]

    def _targets(self) -> np.ndarray:
        length = np.linalg.norm(self._goal, axis=1, keepdims=True)
        pose = np.zeros((len(self._goal), 1, 7))
        pose[:, 0, :2] = self._goal / np.maximum(length, 1e-12) * self._travel[:, None]
        pose[:, 0, 2] = self._top + 1e-3 * self.parameters.policy.gap_mm - self._down
        pose[:, 0, 3] = 1.0  # Face down: half a turn about x.
        return pose

    def control(self) -> Control:
        policy, dt = self.parameters.policy, self.parameters.dt_s
        last = 1e-3 * (policy.gap_mm + policy.depth_mm)
        pressed = self._down >= last - 1e-12
        self._down = np.minimum(self._down + 1e-3 * policy.press_mm_s * dt, last)
        end = 2 * np.linalg.norm(self._goal, axis=1)
        farther = np.minimum(self._travel + 1e-3 * policy.roll_mm_s * dt, end)
        self._travel = np.where(pressed, farther, self._travel)
        return Control(target_poses=self._targets())

    def measure(self) -> None:
        run = self.running
        centre, axes = self.affine_frame()
        moved = centre[:, :2] - self._place
        self._moved[run] = moved[run]
        self._distance[run] = np.linalg.norm(moved - self._goal, axis=1)[run]
        turns = np.linalg.solve(np.swapaxes(self._axes, 1, 2), np.swapaxes(axes, 1, 2))
        turn = rotation_vector(np.swapaxes(turns, 1, 2))
        radius = 1e-3 * self.parameters.ball.radius_mm
        rolled = radius * np.stack([turn[:, 1], -turn[:, 0]], axis=1)
        self._slip[run] = np.linalg.norm(moved - rolled, axis=1)[run]
        self._force[run] = np.linalg.norm(self.force_on("ball", "gel"), axis=1)[run]
        self._strongest = np.maximum(self._strongest, self._force)

    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        length = max(float(np.linalg.norm(self._goal[env])), 1e-12)
        figures = {
            "distance_mm": 1e3 * self._distance[env],
            "part_of_way": self._moved[env] @ self._goal[env] / length**2,
            "slip_on_plane_mm": 1e3 * self._slip[env],
            "strongest_n": self._strongest[env],
        }
        end = 2 * length
        if self._travel[env] < end - 1e-12:
            return "the gel had not gone its way", figures
        if not figures["distance_mm"] <= self.parameters.goal.distance_mm:
            return f"stopped {figures['distance_mm']:.2f} mm from the goal", figures
        return "", figures

    def forces(self) -> dict[str, float]:
        return {"gel on ball": float(self._force[0])}
