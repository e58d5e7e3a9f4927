# SPDX-License-Identifier: Apache-2.0
"""Joints: what of the relative motion of two bodies stays possible, with limits and drives.

Anchors and axes are given once, in world coordinates, with the bodies at their initial poses; from
there each body carries its own copy along. The coordinate of a joint - an angle [rad] or a slide
[m] of the first body relative to the second - is zero there. ``second`` may be an affine body, a
kinematic body, or None for the world.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

import numpy as np

from taccel_lab.bodies.primitives import checked_pose
from taccel_lab.errors import InputError
from taccel_lab.guards import require_positive, require_range, require_shape
from taccel_lab.typed import typed

ROW_COUNT = 7
"""Scalar rows of every joint, see ``ipc.joints.rows``; those that a kind does not have are zero."""


class JointKind(IntEnum):
    """What a joint leaves free."""

    FIXED = 0
    REVOLUTE = 1
    PRISMATIC = 2


@typed
@dataclass(frozen=True)
class PositionDrive:
    """A spring and damper towards a coordinate, as a servo: part of the implicit step."""

    stiffness: float
    """N m/rad of a revolute joint, N/m of a prismatic one."""
    damping: float = 0.0
    """N m s/rad or N s/m."""
    target: float | np.ndarray = 0.0
    """Coordinate to reach [rad or m], one for all environments or [env_count]; many turns work."""
    max_effort: float = math.inf
    """Largest torque [N m] or force [N]."""

    def __post_init__(self) -> None:
        require_positive("stiffness of a drive", self.stiffness)
        require_range("damping of a drive", self.damping, 0, math.inf)
        _check_effort(self.max_effort)
        object.__setattr__(self, "target", _target(self.target))


@typed
@dataclass(frozen=True)
class VelocityDrive:
    """A motor towards a rate, as strong as ``max_effort``."""

    damping: float
    """Effort per rate missing [N m s/rad or N s/m]; large for a drive that does not yield."""
    target: float | np.ndarray = 0.0
    """Rate to reach [rad/s or m/s], one for all environments or [env_count]."""
    max_effort: float = math.inf
    """Largest torque [N m] or force [N]."""

    def __post_init__(self) -> None:
        require_positive("damping of a drive", self.damping)
        _check_effort(self.max_effort)
        object.__setattr__(self, "target", _target(self.target))


Drive = PositionDrive | VelocityDrive


@dataclass(frozen=True)
class Joint:
    """What all joints share; use FixedJoint, RevoluteJoint or PrismaticJoint."""

    kind: ClassVar[JointKind]
    """What the joint leaves free."""
    first: str
    """Name of an affine body."""
    second: str | None = None
    """Name of an affine or kinematic body; the world when None."""
    anchor_m: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0)
    """Point shared by both bodies [m], world, [3] or one an environment [env_count, 3]."""
    axis: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 1.0)
    """Direction that turns or slides, world, [3] or [env_count, 3]; any length but zero. A fixed
    joint needs none."""
    second_pose: np.ndarray | None = None
    """world_from_second that anchor and axis refer to, [7] or [env_count, 7], for a kinematic
    ``second``: its poses belong to the state, not to the scene. The identity when None."""
    name: str = "joint"
    bodies_touch: bool = False
    """Whether contacts between the two bodies are kept; parts of a hinge usually overlap."""

    def __post_init__(self) -> None:
        who = f"joint {self.name!r}"
        if not self.first or not isinstance(self.first, str):
            raise InputError(f"{who} needs the name of its first body, got {self.first!r}")
        if self.second == self.first:
            raise InputError(f"{who} connects {self.first!r} with itself")
        for field in ("anchor_m", "axis"):
            value = np.array(getattr(self, field), dtype=np.float64)
            require_shape(f"{field} of {who}", value, (3,), ("env_count", 3))
            object.__setattr__(self, field, value)
        length = np.linalg.norm(self.axis, axis=-1, keepdims=True)
        if not (length > 1e-12).all():
            raise InputError(f"axis of {who} must not be zero, got {self.axis}")
        object.__setattr__(self, "axis", self.axis / length)
        if self.second_pose is not None:
            if self.second is None:
                raise InputError(f"{who} is to the world, which has no second_pose")
            pose = checked_pose(f"second_pose of {who}", self.second_pose)
            object.__setattr__(self, "second_pose", pose)

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest coordinate [rad or m]."""
        return -math.inf, math.inf

    @property
    def motor(self) -> Drive | None:
        """The drive, if the joint has one."""
        return None

    def joins(self, first: str, second: str) -> bool:
        """Whether it is between these two bodies, in any order."""
        return {first, second} == {self.first, self.second}


@typed
@dataclass(frozen=True)
class FixedJoint(Joint):
    """The bodies move as one."""

    kind = JointKind.FIXED


@typed
@dataclass(frozen=True)
class RevoluteJoint(Joint):
    """A hinge: the first body turns about the axis, by the right-hand rule."""

    kind = JointKind.REVOLUTE
    limits_deg: tuple[float, float] | None = None
    """Smallest and largest angle [deg], around 0; more than a turn is possible."""
    drive: Drive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_limits(self.limits_deg, "limits_deg", self.name)

    @property
    def limits(self) -> tuple[float, float]:
        if self.limits_deg is None:
            return super().limits
        return math.radians(self.limits_deg[0]), math.radians(self.limits_deg[1])

    @property
    def motor(self) -> Drive | None:
        return self.drive


@typed
@dataclass(frozen=True)
class PrismaticJoint(Joint):
    """A slider: the first body moves along the axis and does not turn."""

    kind = JointKind.PRISMATIC
    limits_mm: tuple[float, float] | None = None
    """Smallest and largest slide [mm], around 0."""
    drive: Drive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_limits(self.limits_mm, "limits_mm", self.name)

    @property
    def limits(self) -> tuple[float, float]:
        if self.limits_mm is None:
            return super().limits
        return self.limits_mm[0] * 1e-3, self.limits_mm[1] * 1e-3

    @property
    def motor(self) -> Drive | None:
        return self.drive


def check_joints(
    joints: Collection[Joint], affine: Collection[str], kinematic: Collection[str], env_count: int
) -> None:
    """Refuse joints between bodies that are not there, and arrays for other environment counts.

    ``affine``, ``kinematic``: names of the bodies of the scene.
    """
    names = [joint.name for joint in joints]
    for joint in joints:
        who = f"joint {joint.name!r}"
        if type(joint) is Joint:
            raise InputError(f"{who} must be a FixedJoint, RevoluteJoint or PrismaticJoint")
        if names.count(joint.name) > 1:
            raise InputError(f"{names.count(joint.name)} joints are called {joint.name!r}")
        _check_body(joint.first, f"first of {who}", affine, "affine")
        if joint.second is not None:
            allowed = [*affine, *kinematic]
            _check_body(joint.second, f"second of {who}", allowed, "affine or kinematic")
            if joint.second_pose is not None and joint.second in affine:
                raise InputError(
                    f"second_pose of {who} is for a kinematic body; {joint.second!r} is affine "
                    "and has its own initial pose"
                )
        arrays = {field: getattr(joint, field) for field in ("anchor_m", "axis", "second_pose")}
        for field, value in arrays.items():
            if value is not None and value.ndim == 2 and len(value) != env_count:
                raise InputError(
                    f"{field} of {who} has {len(value)} rows, expected {env_count} or a single one"
                )
        if joint.motor is not None and np.shape(joint.motor.target) not in ((), (env_count,)):
            raise InputError(
                f"drive target of {who} has shape {np.shape(joint.motor.target)}, "
                f"expected a number or [{env_count}]"
            )


def _check_body(name: str, what: str, allowed: Collection[str], kind: str) -> None:
    if list(allowed).count(name) != 1:
        raise InputError(
            f"{what} must be the name of one {kind} body, got {name!r}; "
            f"there are {', '.join(map(repr, allowed)) or 'none'}"
        )


def _check_effort(value: float) -> None:
    if value != math.inf:
        require_positive("max_effort of a drive", value)


def _target(value: float | np.ndarray) -> float | np.ndarray:
    target = np.array(value, dtype=np.float64)
    require_shape("target of a drive", target, (), ("env_count",))
    return target if target.ndim else float(target)


def _check_limits(limits: tuple[float, float] | None, field: str, name: str) -> None:
    if limits is None:
        return
    if len(limits) != 2 or not (limits[0] <= 0 <= limits[1] and limits[0] < limits[1]):
        raise InputError(
            f"{field} of joint {name!r} must be (low, high) with low <= 0 <= high: the initial "
            f"configuration is 0; got {limits}"
        )
