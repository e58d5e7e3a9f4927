# SPDX-License-Identifier: Apache-2.0
"""What a user says about a scene, checked, on the host, without any device array."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from taccel_lab.bodies.bodies import (
    AffineBody,
    Body,
    KinematicBody,
    Plane,
    SoftBody,
    check_friction,
    combined_friction,
)
from taccel_lab.bodies.joints import Joint, check_joints
from taccel_lab.errors import InputError
from taccel_lab.guards import require_known, require_range, require_shape
from taccel_lab.summary import Summary
from taccel_lab.typed import typed


class TimeScheme(StrEnum):
    """How velocities become positions."""

    EULER = "euler"
    """Implicit Euler: first order, never gains energy."""
    BDF2 = "bdf2"
    """Second order backward differences: less damping at the same step."""


SHORTEST_STEP_S, LONGEST_HOLD_S = 1e-6, 1e5
"""Shortest time of a step, and longest of a quasi-static one in which gels relax."""


def check_dt(dt_s: float, longest_s: float = 10.0) -> None:
    """Refuse a length of a step [s] that makes no sense."""
    require_range("dt", dt_s, SHORTEST_STEP_S, longest_s, "s")


@typed
@dataclass(frozen=True)
class TimeStepping:
    """How a step advances time."""

    quasi_static: bool = True
    """Leaves out inertia: each step is an equilibrium. Otherwise ``scheme``."""
    dt_s: float = 0.02
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scheme: TimeScheme = TimeScheme.EULER

    def __post_init__(self) -> None:
        require_known("scheme", self.scheme, TimeScheme)
        object.__setattr__(self, "scheme", TimeScheme(self.scheme))
        check_dt(self.dt_s)
        gravity = self.gravity_m_s2
        require_shape("gravity_m_s2", gravity, (3,))
        if self.quasi_static and any(gravity):
            raise InputError(
                f"gravity_m_s2 = {gravity} needs quasi_static=False: otherwise nothing has mass"
            )

    @property
    def bdf2(self) -> bool:
        """Whether a step depends on the one before."""
        return not self.quasi_static and self.scheme is TimeScheme.BDF2


@dataclass(frozen=True, init=False, repr=False)
class SceneDescription(Summary):
    """Bodies and how they meet, in ``env_count`` copies; ``scene.Scene`` puts it on a device.

    Copies share connectivity and differ in rest shape, state, kinematic poses, and in which of the
    affine and kinematic bodies are present.
    """

    soft_bodies: tuple[SoftBody, ...]
    kinematic_bodies: tuple[KinematicBody, ...]
    env_count: int
    time: TimeStepping
    affine_bodies: tuple[AffineBody, ...]
    planes: tuple[Plane, ...]
    joints: tuple[Joint, ...]
    pair_friction: Mapping[tuple[str, str], float]
    """Coefficient of a pair of bodies by name. Other pairs take the harmonic mean of the bodies'
    own coefficients; a body whose own is None takes the other's."""

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """Return what ``repr`` shows."""
        lists = {
            "kinematic": self.kinematic_bodies,
            "affine": self.affine_bodies,
            "planes": self.planes,
            "joints": self.joints,
        }
        rows = [(body.name, f"{body.mesh.node_count} nodes") for body in self.soft_bodies]
        rows += [(name, str(len(items))) for name, items in lists.items() if items]
        time = "quasi-static" if self.time.quasi_static else f"steps of {1e3 * self.time.dt_s:g} ms"
        return f"scene, env_count = {self.env_count}", [*rows, ("time", time)]

    def __init__(
        self,
        soft_bodies: SoftBody | Sequence[SoftBody] = (),
        kinematic_bodies: KinematicBody | Sequence[KinematicBody] = (),
        env_count: int = 1,
        time: TimeStepping | None = None,
        affine_bodies: AffineBody | Sequence[AffineBody] = (),
        planes: Plane | Sequence[Plane] = (),
        joints: Joint | Sequence[Joint] = (),
        pair_friction: Mapping[tuple[str, str], float] | None = None,
    ) -> None:
        """One body may be given without a list around it; see the fields."""
        lists = {
            "soft_bodies": (soft_bodies, SoftBody),
            "kinematic_bodies": (kinematic_bodies, KinematicBody),
            "affine_bodies": (affine_bodies, AffineBody),
            "planes": (planes, Plane),
            "joints": (joints, Joint),
        }
        for name, (value, kind) in lists.items():
            items = (value,) if isinstance(value, kind) else tuple(value)
            for item in items:
                if not isinstance(item, kind):
                    raise InputError(f"{name} must hold {kind.__name__} objects, got {item!r}")
            object.__setattr__(self, name, items)
        object.__setattr__(self, "env_count", env_count)
        object.__setattr__(self, "time", time or TimeStepping())
        object.__setattr__(self, "pair_friction", dict(pair_friction or {}))
        require_range("env_count", self.env_count, 1, math.inf)
        if not self.soft_bodies and not self.affine_bodies:
            raise InputError("a scene needs at least one soft or affine body")
        if self.time.quasi_static and self.affine_bodies:
            raise InputError(
                "affine bodies need quasi_static=False: without inertia nothing holds them"
            )
        for body in self.soft_bodies:
            self._check_soft(body)
        self._check_environments()
        self._check_names()
        check_joints(
            self.joints,
            [body.name for body in self.affine_bodies],
            [body.name for body in self.kinematic_bodies],
            self.env_count,
        )

    def _check_soft(self, body: SoftBody) -> None:
        rest = body.rest_positions_m
        expected = (self.env_count, body.mesh.node_count, 3)
        if rest is not None and np.shape(rest) != expected:
            raise InputError(f"rest_positions_m has shape {np.shape(rest)}, expected {expected}")
        if rest is not None and not np.isfinite(rest).all():
            env = int(np.argwhere(~np.isfinite(rest))[0, 0])
            raise InputError(f"rest_positions_m holds NaN or infinite values in environment {env}")
        bonded = body.bonded()
        if len(bonded) and (bonded[0] < 0 or bonded[-1] >= body.mesh.node_count):
            raise InputError("bonded_nodes refers to nodes that do not exist")
        if len(bonded) >= body.mesh.node_count:
            raise InputError("all nodes of the soft body are bonded; at least one must be free")
        if self.time.quasi_static and len(bonded) < 3:
            raise InputError(
                "a quasi-static soft body needs at least three bonded nodes: "
                "without inertia nothing else holds it"
            )

    def _check_environments(self) -> None:
        for body in self.bodies:
            present = body.surface.environments
            if present is not None and not all(0 <= env < self.env_count for env in present):
                raise InputError(
                    f"environments of {body.name!r} must lie in [0, {self.env_count - 1}], "
                    f"got {present}"
                )
            pose = getattr(body, "initial_pose", None)
            if pose is not None and pose.ndim == 2 and len(pose) != self.env_count:
                raise InputError(
                    f"initial_pose of {body.name!r} has {len(pose)} rows, "
                    f"expected {self.env_count} or a single pose"
                )

    def _check_names(self) -> None:
        names = [body.name for body in self.bodies]
        for body in self.bodies:
            for name in body.surface.apart_from.difference(names):
                raise InputError(f"{body.name!r} is kept apart from {name!r}, which is no body")
        for pair, value in self.pair_friction.items():
            for name in pair:
                if names.count(name) != 1:
                    raise InputError(
                        f"pair_friction names {name!r}, which {names.count(name)} bodies are "
                        f"called; bodies: {', '.join(map(repr, names))}"
                    )
            check_friction(value, f"the pair {pair}")
        frames = [body.name for body in (*self.affine_bodies, *self.kinematic_bodies)]
        for body in self.soft_bodies:
            if body.mount is not None and frames.count(body.mount) != 1:
                raise InputError(
                    f"mount {body.mount!r} of {body.name!r} must be the name of one kinematic or "
                    f"affine body; there are {', '.join(map(repr, frames)) or 'none'}"
                )
            carrier = self.carrier(body)
            if carrier is not None:
                _check_carried(body, carrier)
            elif body.mount_pose is not None:
                raise InputError(
                    f"mount_pose of {body.name!r} is for a mount that is an affine body; "
                    f"{body.mount!r} is kinematic, and the mesh is given in its frame"
                )

    def soft_body(self, index: int) -> SoftBody:
        """One of ``soft_bodies``; InputError where there is none of that number."""
        if not 0 <= index < len(self.soft_bodies):
            raise InputError(
                f"there is no soft body {index}; the scene has {len(self.soft_bodies)}"
            )
        return self.soft_bodies[index]

    def carrier(self, body: SoftBody) -> AffineBody | None:
        """The affine body that a gel is mounted on; None for any other gel."""
        return next((other for other in self.affine_bodies if other.name == body.mount), None)

    @property
    def carriers(self) -> list[int]:
        """Index of the affine body that each soft body is mounted on, -1 for none."""
        index = {body.name: i for i, body in enumerate(self.affine_bodies)}
        return [index.get(str(body.mount), -1) for body in self.soft_bodies]

    @property
    def bodies(self) -> list[Body]:
        """All bodies in the order of their ids: soft, affine, kinematic, planes."""
        return [*self.soft_bodies, *self.affine_bodies, *self.kinematic_bodies, *self.planes]

    def friction_between(self, first: Body, second: Body) -> float:
        """Coulomb coefficient of a pair of bodies."""
        for pair in ((first.name, second.name), (second.name, first.name)):
            if pair in self.pair_friction:
                return self.pair_friction[pair]
        return combined_friction(first, second)

    def may_touch(self, first: Body, second: Body) -> bool:
        """Whether two different bodies are searched for contacts with each other at all.

        One description may stand for several bodies, so they may be the same object.
        """
        moves = (SoftBody, AffineBody)
        if not isinstance(first, moves) and not isinstance(second, moves):
            return False
        if first.name in second.surface.apart_from or second.name in first.surface.apart_from:
            return False
        for body, other in ((first, second), (second, first)):
            if isinstance(body, SoftBody) and body.mount == other.name:
                return False
        if any(j.joins(first.name, second.name) and not j.bodies_touch for j in self.joints):
            return False
        if any(isinstance(body, KinematicBody) and body.shape is None for body in (first, second)):
            return False
        return first.surface.meets(second.surface)


def _check_carried(body: SoftBody, carrier: AffineBody) -> None:
    """Refuse what a gel on an affine body cannot have."""
    if carrier.surface.environments is not None:
        raise InputError(
            f"{carrier.name!r} carries {body.name!r}: it must be present in all environments"
        )
    if any(body.initial_velocity_m_s):
        raise InputError(f"{body.name!r} starts to move as its mount {carrier.name!r} does")
    rest = body.rest_positions_m
    bonded = body.bonded()
    if len(bonded) == 0:
        raise InputError(f"{body.name!r} has a mount, but no bonded nodes to hold it there")
    if rest is not None and (np.asarray(rest)[:, bonded] != np.asarray(rest)[:1, bonded]).any():
        raise InputError(
            f"rest_positions_m of {body.name!r} must have the bonded nodes in the same places in "
            f"all environments: its mount {carrier.name!r} is affine"
        )
