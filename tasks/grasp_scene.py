# SPDX-License-Identifier: Apache-2.0
"""A parallel gripper with two gels above a body on a plane, stiff or soft."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.robots import Robot, named, on_seat
from taccel_lab.scene import AffineBody, Plane, Scene, SoftBody, TimeStepping
from taccel_lab.tasks.bodies import pad_body, pad_mesh
from taccel_lab.tasks.physics import G

if TYPE_CHECKING:
    from taccel_lab.tasks.parameters import Pad

SIDES = ("left", "right")


@dataclass(frozen=True)
class GraspScene:
    """The scene, its robot, and where these begin."""

    scene: Scene
    robot: Robot
    base: np.ndarray
    """Pose of the robot's base, [7]: fingers point down, their tips' frame at the object's
    middle."""
    rest_height_m: float
    """Of the object's middle: contact has just begun."""


def grasp_scene(
    robot_name: str,
    pad: Pad,
    grasped: Callable[[np.ndarray], AffineBody | SoftBody],
    half_height_m: float,
    poses: np.ndarray,
    *,
    plane_friction: float,
    dhat_mm: float,
    dt_s: float,
) -> GraspScene:
    """The scene of ``poses`` of the object, [env, 7], whose heights do not count: of ``grasped``
    there, whose middle is ``half_height_m`` over its lowest point."""
    robot = named(robot_name).touching([f"finger_{side}" for side in SIDES])
    mesh = pad_mesh(pad)
    for side in SIDES:
        robot = robot.mount(f"finger_{side}", pad_body(pad, mesh), on_seat(mesh), f"{side} pad")
    # It lies where contact has just begun, and settles while the fingers close.
    height = half_height_m + 1e-3 * dhat_mm
    poses = np.array(poses)
    poses[:, 2] = height
    tcp = robot.link_poses("tcp", robot.rest_q)[0]
    body = grasped(poses)
    soft = [body] if isinstance(body, SoftBody) else []
    scene = Scene(
        [*robot.soft_bodies(), *soft],
        robot.kinematic_bodies(),
        len(poses),
        TimeStepping(False, dt_s, (0.0, 0.0, -G)),
        affine_bodies=[] if isinstance(body, SoftBody) else body,
        planes=Plane(friction_coefficient=plane_friction),
    )
    base = np.array([0.0, 0.0, half_height_m + tcp[2], 1.0, 0.0, 0.0, 0.0])
    return GraspScene(scene, robot, base, height)
