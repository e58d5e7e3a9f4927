# SPDX-License-Identifier: Apache-2.0
"""A robot with a gel on each finger above a body on a plane, stiff or soft, and what becomes of
that body as it is gripped and lifted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.strict_model import Number, StrictModel
from taccel_lab.robots import Robot, named, on_seat
from taccel_lab.scene import AffineBody, Plane, Scene, SoftBody, TimeStepping
from taccel_lab.tasks.bodies import G, pad_body, pad_mesh
from taccel_lab.tasks.parameters import Positive

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
    if sensor is not None and sensor.material.layers:
        raise InputError(
            f"sensor {sensor.sensor.name!r} has a gel of several layers: grasps take gels of one"
        )
    mesh = pad_mesh(pad) if sensor is None else sensor.mesh
    gel = sensor or pad_body(pad, mesh)
    for name, link in grasper.pads.items():
        robot = robot.mount(link, gel, on_seat(mesh), name)
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


class LiftGoal(StrictModel):
    """When it is done: so high over where it lay at the end, and for as long without a break."""

    lift_mm: Positive
    hold_s: Number


class LiftRecord:
    """Rise, slip in the grip, forces of the grip, and for how long it has been high."""

    def __init__(
        self, goal: LiftGoal, dt_s: float, rest_height_m: float | np.ndarray, shape: tuple[int, int]
    ) -> None:
        """
        Args:
            goal: Of the task.
            dt_s: Of a step.
            rest_height_m: Of the object's middle as it lies, or [env].
            shape: Numbers of environments and of gels.
        """
        count, _ = shape
        self._goal, self._dt_s, self._rest = goal, dt_s, rest_height_m
        self.gripping = np.zeros(count, dtype=bool)
        """Environments in which closing has ended, bool, [env]."""
        self.pushing = np.zeros(shape, dtype=bool)
        """Gels that pushed on the object when it ended, bool, [env, gel]."""
        self.grip_n = np.zeros(shape)
        """Forces of the gels on the object in the last step [N], [env, gel]."""
        self._weakest, self._strongest = np.full(count, np.nan), np.zeros(count)
        self._gripped_at = np.full((count, 3), np.nan)
        self._slip = np.full(count, np.nan)
        self._rise = np.zeros(count)
        self._held = np.zeros(count, dtype=int)

    def look(
        self,
        running: np.ndarray,
        begins: np.ndarray,
        middle_m: np.ndarray,
        raised_m: np.ndarray,
    ) -> None:
        """Take in a step, whose forces are in ``grip_n``.

        Args:
            running: Environments that took it, bool, [env].
            begins: Those in which closing ended with it, bool, [env].
            middle_m: Of the object, [env, 3].
            raised_m: How far the hand has risen, [env].
        """
        relative = middle_m - np.array([0.0, 0.0, 1.0]) * raised_m[:, None]
        self._gripped_at[begins] = relative[begins]
        self.pushing[begins] = self.grip_n[begins] > 0
        self.gripping |= begins
        holding = running & self.gripping
        slip = np.linalg.norm(relative - self._gripped_at, axis=1)
        self._slip[holding] = slip[holding]
        least = np.where(self.pushing, self.grip_n, np.inf).min(axis=1)
        least[~self.pushing.any(axis=1)] = 0.0
        self._weakest[holding] = np.fmin(self._weakest, least)[holding]
        strongest = np.maximum(self._strongest, self.grip_n.max(axis=1))
        self._strongest[running] = strongest[running]
        self._rise[running] = (middle_m[:, 2] - self._rest)[running]
        high = self._rise >= 1e-3 * self._goal.lift_mm
        self._held[running] = np.where(high, self._held + 1, 0)[running]

    @property
    def slip_m(self) -> np.ndarray:
        """How far the object has moved in the hand since the grip, NaN before, [env]."""
        return self._slip

    @property
    def done(self) -> np.ndarray:
        """Environments that meet the goal now, bool, [env]."""
        return self._held * self._dt_s >= self._goal.hold_s - 1e-9

    def figures(self, env: int) -> dict[str, float]:
        """Figures of an environment; of the grip by the gels that pushed when closing ended."""
        found = {
            "rise_mm": 1e3 * self._rise[env],
            "held_s": self._held[env] * self._dt_s,
            "slip_mm": 1e3 * self._slip[env],
            "weakest_grip_n": self._weakest[env],
            "strongest_grip_n": self._strongest[env],
        }
        return {name: float(value) for name, value in found.items()}

    def missed(self, env: int) -> str:
        """What of the goal an environment misses, empty if nothing."""
        if self._rise[env] < 1e-3 * self._goal.lift_mm:
            return f"rose by {1e3 * self._rise[env]:.1f} mm at the end"
        if not self.done[env]:
            return f"was held high for {self._held[env] * self._dt_s:.2f} s"
        return ""
