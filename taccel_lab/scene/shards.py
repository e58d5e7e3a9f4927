# SPDX-License-Identifier: Apache-2.0
"""Cutting a scene into parts that hold some of its environments each.

Environments do not influence one another, so parts can be stepped anywhere without a word between
them: in several processes, each of which takes the part of its rank and its own device.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from taccel_lab.bodies.bodies import Body, Surface
from taccel_lab.bodies.joints import Drive, Joint
from taccel_lab.errors import InputError
from taccel_lab.guards import require_range
from taccel_lab.scene.scene import Scene

T = TypeVar("T")

PER_ENVIRONMENT = {
    "rest_positions_m": 3,
    "initial_pose": 2,
    "anchor_m": 2,
    "axis": 2,
    "second_pose": 2,
    "target": 1,
}
"""Fields of bodies, joints and drives that may hold a row for each environment, and how many
dimensions they have then; with fewer, all environments share what they hold."""


def shard_slice(env_count: int, rank: int, world_size: int) -> slice:
    """Environments of one of ``world_size`` parts, whose sizes differ by one at most.

    For arrays of the whole scene: ``targets[shard_slice(env_count, rank, world_size)]``.
    """
    require_range("world_size", world_size, 1, math.inf)
    require_range("rank", rank, 0, world_size - 1)
    if world_size > env_count:
        raise InputError(
            f"{env_count} environments cannot be split into {world_size} parts: each part needs "
            f"at least one, so at most {env_count} devices or processes can share them"
        )
    least, more = divmod(env_count, world_size)
    first = rank * least + min(rank, more)
    return slice(first, first + least + (rank < more))


def shard_of(scene: Scene, rank: int, world_size: int) -> Scene:
    """The part of a scene that process ``rank`` of ``world_size`` simulates."""
    part = shard_slice(scene.env_count, rank, world_size)
    return cut_scene(scene, part.start, part.stop)


def cut_scene(scene: Scene, first: int, last: int) -> Scene:
    """The environments ``first`` to ``last - 1`` of a scene, as a scene of their own.

    Meshes and everything else that environments share is shared with the scene, not copied. Bodies
    that are absent from all environments of the part stay in it: nodes keep their numbers.
    """
    if not 0 <= first < last <= scene.env_count:
        raise InputError(
            f"environments [{first}, {last}) must be at least one of the scene's "
            f"{scene.env_count}, numbered from 0"
        )
    part = slice(first, last)
    return _with(
        scene,
        env_count=last - first,
        soft_bodies=tuple(_cut_body(body, part) for body in scene.soft_bodies),
        affine_bodies=tuple(_cut_body(body, part) for body in scene.affine_bodies),
        kinematic_bodies=tuple(_cut_body(body, part) for body in scene.kinematic_bodies),
        planes=tuple(_cut_body(body, part) for body in scene.planes),
        joints=tuple(_cut_joint(joint, part) for joint in scene.joints),
    )


def _cut_body(body: Any, part: slice) -> Any:
    checked: Body = body
    return _with(checked, surface=_cut_surface(checked.surface, part), **_rows(checked, part))


def _cut_surface(surface: Surface, part: slice) -> Surface:
    if surface.environments is None:
        return surface
    here = (env - part.start for env in surface.environments if part.start <= env < part.stop)
    return _with(surface, environments=tuple(here))


def _cut_joint(joint: Joint, part: slice) -> Joint:
    drive: Drive | None = joint.motor
    changed: dict[str, Any] = _rows(joint, part)
    if drive is not None:
        changed["drive"] = _with(drive, **_rows(drive, part))
    return _with(joint, **changed)


def _rows(item: Any, part: slice) -> dict[str, Any]:
    """Rows of the environments of a part, of each field that has a row for each environment."""
    found = {}
    for field in fields(item):
        value = getattr(item, field.name)
        if np.ndim(value) == PER_ENVIRONMENT.get(field.name) and value is not None:
            found[field.name] = value[part]
    return found


def _with(item: T, **changed: Any) -> T:
    """A copy with other values of some fields.

    Not ``dataclasses.replace``: that would check and normalise again what has been, and a unit
    vector that is normalised twice may differ in its last digit.
    """
    made = copy(item)
    for name, value in changed.items():
        object.__setattr__(made, name, value)
    return made
