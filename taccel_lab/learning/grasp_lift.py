# SPDX-License-Identifier: Apache-2.0
"""The grasp and lift of ``tasks.grasp_lift``, to be learned: same scene, starts and criterion.

There the object lies off the middle between the fingers; here the gripper begins off the object by
the inverse. An action moves the gripper in the frame in which it began, turns it about the
vertical, and moves the joints of its fingers, whose links follow their targets exactly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import torch
import warp as wp

from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError
from taccel_lab.learning.task import Judgement, LearningTask, about_z, compose, planar_inverse
from taccel_lab.model import Model
from taccel_lab.robots import Robot
from taccel_lab.state import State
from taccel_lab.tasks.bodies import contact_config, free_body, solid
from taccel_lab.tasks.grasp_scene import grasp_scene

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile
    from taccel_lab.tasks.grasp_lift import GraspLiftParameters


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
        """Names of the coordinates as of ``in_mm_and_deg``."""
        self._shown = np.where(slides, 1e3, np.degrees(1.0))

    def attach(self, env_count: int, device: torch.device | str) -> None:
        """Make the tensors of a number of environments, all at the start."""
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
        """Poses of ``robot.kinematic_bodies``, [env, body, 7]."""
        return self.robot.targets(self.q, check=False)

    def in_mm_and_deg(self) -> torch.Tensor:
        """Coordinates in mm and degrees, [env, dof]."""
        return self.q * self._scale


SUCCESS_REWARD = 1.0
"""Reward beside the part of the height that each step gains."""


class GraspLiftLearning(LearningTask):
    """Grasp and lift of some environments."""

    start_names = ("x_mm", "y_mm", "yaw_deg")

    def __init__(
        self,
        parameters: GraspLiftParameters,
        env_count: int,
        sensor: SensorProfile | None = None,
    ) -> None:
        start, policy, learning = parameters.start, parameters.policy, parameters.learning
        goal, dt = parameters.goal, parameters.dt_s
        shape = solid(parameters.object.shape, parameters.object.size_mm)
        built = grasp_scene(
            parameters.robot,
            parameters.gel,
            lambda poses: free_body(parameters.object, shape, "object", poses),
            -float(shape.vertices_m[:, 2].min()),
            np.tile([0.0, 0, 0, 0, 0, 0, 1], (env_count, 1)),
            closed_m=1e-3 * policy.closed_mm,
            sensor=sensor,
            plane_friction=parameters.plane_friction,
            dhat_mm=parameters.contact.dhat_mm,
            dt_s=dt,
        )
        self.scene = built.scene
        self.config = contact_config(parameters.contact)
        self.step_limit = parameters.steps
        self.start_half = (start.x_mm, start.y_mm, start.yaw_deg)
        self.randomised = tuple(learning.randomise)
        self.sensor, self.gels = sensor, tuple(built.grasper.pads)
        kinds = {joint.name: joint.kind for joint in built.robot.joints}
        dofs = built.robot.dof_names
        units = [1e-3 if kinds[name] is JointKind.PRISMATIC else np.radians(1.0) for name in dofs]
        self._joints = JointControl(
            built.robot,
            built.grasper.closed(np.array([1e-3 * policy.open_mm]))[0],
            dt * learning.joint_speed * np.array(units),
            actions=learning.joint_actions,
            reach=learning.joint_reach * np.array(units),
        )
        self.action_names = ("x", "y", "z", "yaw", *dofs)
        self.proprioception_names = ("x_mm", "y_mm", "z_mm", "yaw_deg", *self._joints.names)
        self._base_pose = built.base
        self._rest_m = built.rest_height_m
        self._goal_m, self._hold_steps = 1e-3 * goal.lift_mm, goal.hold_s / dt - 1e-6
        speeds = [1e-3 * speed for speed in learning.speed_mm_s]
        self._per_step = dt * np.array([*speeds, np.radians(learning.turn_deg_s)])
        reach = [1e-3 * reach for reach in learning.reach_mm]
        self._reach = np.array([*reach, np.radians(learning.reach_deg)])

    def attach(self, model: Model, state: State) -> None:
        count, device = model.env_count, wp.device_to_torch(model.device)

        def put(values: np.ndarray) -> torch.Tensor:
            return torch.tensor(values, dtype=torch.float64, device=device)

        self._state = state
        self._centre = model.affine.first_control
        self._step_size, self._most = put(self._per_step), put(self._reach)
        # Not below where it began: there is the plane.
        self._least = put(-self._reach * [1, 1, 0, 1])
        self._base = put(self._base_pose)
        self._joints.attach(count, device)
        self._start = put(np.tile([0.0, 0, 0, 0, 0, 0, 1], (count, 1)))
        """Frame in which the gripper began, [env, 7]."""
        self._moved = put(np.zeros((count, 4)))
        """Motion of the gripper [m], and its turn [rad], since the start."""
        self._rise = put(np.zeros(count))
        self._held = torch.zeros(count, dtype=torch.int32, device=device)
        """Steps that the object has been high."""

    def begin(self, who: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
        self._start = torch.where(who[:, None], planar_inverse(start), self._start)
        self._moved = torch.where(who[:, None], 0.0, self._moved)
        self._joints.begin(who)
        self._rise = torch.where(who, 0.0, self._rise)
        self._held = torch.where(who, 0, self._held)
        return self._poses()

    def act(self, who: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        moved = self._moved + self._step_size * action[:, :4]
        moved = torch.minimum(torch.maximum(moved, self._least), self._most)
        self._moved = torch.where(who[:, None], moved, self._moved)
        self._joints.act(who, action[:, 4:])
        return self._poses()

    def _poses(self) -> torch.Tensor:
        moved = torch.cat([self._moved[:, :3], about_z(self._moved[:, 3])], dim=1)
        # The base hangs above the object's middle, and turns about the vertical through it.
        base = compose(self._start, compose(moved, self._base))
        return compose(base[:, None], self._joints.poses())

    def judge(self) -> Judgement:
        """The reward is the part of the asked height that the step gained, and 1 for success."""
        positions = wp.to_torch(self._state.positions, requires_grad=False)
        rise = positions[:, self._centre, 2] - self._rest_m
        gained = (rise - self._rise).clamp(-self._goal_m, self._goal_m) / self._goal_m
        self._rise = rise
        self._held = torch.where(rise >= self._goal_m, self._held + 1, 0)
        success = self._held >= self._hold_steps
        reward = gained + SUCCESS_REWARD * success
        return Judgement(reward.float(), success, {"rise_mm": 1e3 * rise.float()})

    def proprioception(self) -> torch.Tensor:
        yaw = torch.rad2deg(self._moved[:, 3:])
        return torch.cat([1e3 * self._moved[:, :3], yaw, self._joints.in_mm_and_deg()], dim=1)
