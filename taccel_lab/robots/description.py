# SPDX-License-Identifier: Apache-2.0
"""What a robot is made of: links, and joints that make a tree of them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError
from taccel_lab.files.declared import require_few
from taccel_lab.robots.shapes import CollisionShape

MAX_LINKS = 2500
"""Most links, and joints, of a robot; each axis of a joint of several has a link of its own."""


@dataclass(frozen=True)
class LinkMass:
    """Mass and inertia of a link, in the frame of the link."""

    mass_kg: float
    center_m: np.ndarray
    """Centre of mass, shape [3]."""
    inertia_kg_m2: np.ndarray
    """Inertia about the centre of mass, shape [3, 3]."""


@dataclass(frozen=True)
class Link:
    """A rigid part of a robot."""

    name: str
    shapes: tuple[CollisionShape, ...] = ()
    mass: LinkMass | None = None
    """None where the file says nothing of it."""


@dataclass(frozen=True)
class Mimic:
    """A joint follows another one: its coordinate is ``multiplier`` times that, plus ``offset``."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class RobotJoint:
    """How a link moves on another one."""

    name: str
    kind: JointKind
    parent: str
    child: str
    parent_from_joint: np.ndarray
    """The frame of the joint in the parent, that of the child at coordinate 0; float64, [4, 4]."""
    axis: np.ndarray
    """Direction that the child turns about or slides along, unit, in the joint's frame, [3]."""
    lower: float = -math.inf
    """Smallest coordinate [rad or m]; none for a continuous joint."""
    upper: float = math.inf
    max_effort: float = math.inf
    """Largest torque [N m] or force [N] of its drive."""
    mimic: Mimic | None = None

    @property
    def moves(self) -> bool:
        """Whether it leaves anything free."""
        return self.kind is not JointKind.FIXED


def check_names(what: str, names: Sequence[str]) -> None:
    """Refuse a name that two ``what`` have."""
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError(f"{count} {what} are called {name!r}; each needs its own")


def listed(names: Iterable[str]) -> str:
    """Names as a sentence has them."""
    return ", ".join(map(repr, names)) or "none"


def base_of(links: Sequence[Link], joints: Sequence[RobotJoint]) -> str:
    """Name of the one link that no joint carries.

    Raises InputError where links and joints do not make one tree: two of a name, unknown links, a
    link on two joints (a loop), several bases, or a ring.
    """
    names = [link.name for link in links]
    if not names:
        raise InputError("a robot needs at least one link")
    for what, count in (("links", len(links)), ("joints", len(joints))):
        require_few("the robot", what, count, MAX_LINKS)
    check_names("links", names)
    check_names("joints", [joint.name for joint in joints])
    carried: dict[str, RobotJoint] = {}
    for joint in joints:
        for end, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in names:
                raise InputError(
                    f"{end} of joint {joint.name!r} is {name!r}, which is no link; there are "
                    f"{listed(names)}"
                )
        if joint.child in carried:
            raise InputError(
                f"link {joint.child!r} is the child of two joints, {carried[joint.child].name!r} "
                f"and {joint.name!r}: closed loops are not supported, a link has one parent"
            )
        carried[joint.child] = joint
    bases = [name for name in names if name not in carried]
    if len(bases) > 1:
        raise InputError(
            f"{len(bases)} links are the child of no joint: {listed(bases)}; a robot has one base, "
            "connect the others by fixed joints"
        )
    sound = set(bases)
    for name in names:
        seen: dict[str, None] = {}
        while name not in sound:
            if name in seen:
                raise InputError(
                    f"links {listed(seen)} carry each other in a ring: a robot is a tree with one "
                    "base"
                )
            seen[name] = None
            name = carried[name].parent
        sound.update(seen)
    return bases[0]


def coordinate_map(joints: Sequence[RobotJoint]) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Coordinates of all joints from those that move by themselves: ``factors @ q + offsets``.

    Returns ``factors`` [joint, dof], ``offsets`` [joint], and the names of the joints that move by
    themselves, in the order of ``joints``. A joint that follows a follower follows its leader.

    Raises InputError for a joint that follows a fixed or unknown one, or itself.
    """
    by_name = {joint.name: joint for joint in joints}
    leaders = [joint.name for joint in joints if joint.moves and joint.mimic is None]
    factors, offsets = np.zeros((len(joints), len(leaders))), np.zeros(len(joints))
    for i, joint in enumerate(joints):
        if not joint.moves:
            continue
        factor, offset, seen = 1.0, 0.0, [joint.name]
        while (mimic := by_name[seen[-1]].mimic) is not None:
            followed = by_name.get(mimic.joint)
            if followed is None or not followed.moves:
                kind = "fixed" if followed is not None else "no joint of the robot"
                raise InputError(f"joint {seen[-1]!r} mimics {mimic.joint!r}, which is {kind}")
            offset += factor * mimic.offset
            factor *= mimic.multiplier
            seen.append(mimic.joint)
            if mimic.joint in seen[:-1]:
                raise InputError(f"joints {listed(dict.fromkeys(seen))} mimic each other in a ring")
        factors[i, leaders.index(seen[-1])] = factor
        offsets[i] = offset
    return factors, offsets, leaders


def limits_of(
    joints: Sequence[RobotJoint], factors: np.ndarray, offsets: np.ndarray, leaders: list[str]
) -> np.ndarray:
    """Smallest and largest coordinates of the joints that move by themselves [dof, 2], within which
    those that follow keep theirs, too.

    Raises InputError where that leaves nothing.
    """
    limits = np.tile([-math.inf, math.inf], (len(leaders), 1))
    for joint, row, offset in zip(joints, factors, offsets, strict=True):
        for leader in np.flatnonzero(row):
            ends = (np.array([joint.lower, joint.upper]) - offset) / row[leader]
            limits[leader, 0] = max(limits[leader, 0], ends.min())
            limits[leader, 1] = min(limits[leader, 1], ends.max())
    for name, (low, high) in zip(leaders, limits, strict=True):
        if low > high:
            raise InputError(
                f"joint {name!r} cannot be anywhere: its limits and those of the joints that mimic "
                f"it leave nothing between {low:g} and {high:g}"
            )
    return limits
