# SPDX-License-Identifier: Apache-2.0
"""A robot with a gel on each finger above a body on a plane, stiff or soft."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.robots import Robot, named, on_seat
from taccel_lab.scene import AffineBody, Plane, Scene, SoftBody, TimeStepping
from taccel_lab.tasks.bodies import G, pad_body, pad_mesh, sensor_gel

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile
    from taccel_lab.tasks.parameters import PadParameters


@dataclass(frozen=True)
class Grasper:
    """How a robot of the catalogue holds gels and closes them."""

    pads: Mapping[str, str]
    """Links that carry gels, by the names of the gels."""
    touched: tuple[str, ...]
    """Links whose shapes are touched, others are not."""
    closed: Callable[[np.ndarray], np.ndarray]
    """Coordinates [n, dof] for distances of the gels' seats from the middle between them [m], [n],
    which face it squarely."""


def _upright_fingers(seat_m: np.ndarray) -> np.ndarray:
    # Knuckles bend in and middles out by the same angle. Seats stand 35 mm from the axis at 0 and
    # 52 mm above the knuckles.
    angle = np.arcsin((35e-3 - seat_m) / 52e-3)
    return np.tile(np.stack([0 * angle, angle, -angle], axis=-1), 3)


GRASPERS = {
    "parallel_gripper": Grasper(
        {"left pad": "finger_left", "right pad": "finger_right"},
        ("finger_left", "finger_right"),
        lambda seat_m: seat_m[:, None],
    ),
    "three_finger_hand": Grasper(
        {f"pad {k}": f"pad_{k}" for k in (1, 2, 3)},
        ("distal_1", "distal_2", "distal_3"),
        _upright_fingers,
    ),
}


@dataclass(frozen=True)
class GraspScene:
    """The scene, its robot, and where these begin."""

    scene: Scene
    robot: Robot
    grasper: Grasper
    base: np.ndarray
    """Pose of the robot's base, [7]: fingers point down, the seats of their gels are as high as the
    object's middle when they are closed."""
    rest_height_m: float
    """Height of the object's middle: contact has just begun."""


def grasp_scene(
    robot_name: str,
    pad: PadParameters,
    grasped: Callable[[np.ndarray], AffineBody | SoftBody],
    half_height_m: float,
    poses: np.ndarray,
    *,
    closed_m: float,
    sensor: SensorProfile | None = None,
    plane_friction: float,
    dhat_mm: float,
    dt_s: float,
) -> GraspScene:
    """The scene of ``poses`` of the object, [env, 7], whose heights do not count: of ``grasped``
    there, whose middle is ``half_height_m`` over its lowest point. Fingers close until seats of
    gels are ``closed_m`` from the middle. Gels of ``sensor`` stand in place of ``pad``.

    Raises InputError for a sensor whose gel has layers of several materials.
    """
    grasper = GRASPERS[robot_name]
    robot = named(robot_name).touching(grasper.touched)
    gel = pad_body(pad, pad_mesh(pad)) if sensor is None else sensor_gel(sensor)
    for name, link in grasper.pads.items():
        robot = robot.mount(link, gel, on_seat(gel.mesh), name)
    # It lies where contact has just begun, and settles while the fingers close.
    height = half_height_m + 1e-3 * dhat_mm
    poses = np.array(poses)
    poses[:, 2] = height
    q = grasper.closed(np.array([closed_m]))
    seats = [robot.link_poses(link, q)[0, 2] for link in grasper.pads.values()]
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
    base = np.array([0.0, 0.0, half_height_m + np.mean(seats), 1.0, 0.0, 0.0, 0.0])
    return GraspScene(scene, robot, grasper, base, height)
