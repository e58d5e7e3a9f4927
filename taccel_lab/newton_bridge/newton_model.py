# SPDX-License-Identifier: Apache-2.0
"""A newton model on the host: its arrays in double precision, its labels made short and unique."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np

from taccel_lab.bodies.mass_properties import MassProperties
from taccel_lab.errors import InputError
from taccel_lab.guards import unknown
from taccel_lab.robots.transforms import pose_of

NOT_INSTALLED = "this needs newton, which is not installed: pip install 'taccel-lab[newton]'"


def newton_module() -> Any:
    """The package ``newton``; InputError where it is not installed."""
    try:
        import newton  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError(NOT_INSTALLED) from None
    return newton


class NewtonModel:
    """What is read of a ``newton.Model``, or of a ``newton.ModelBuilder``, which is finalised."""

    def __init__(self, source: Any, *, worlds: bool = False) -> None:
        """
        Args:
            source: The model or its builder.
            worlds: Whether there may be several, all alike: names and indices are then those of the
                first one, and body b of world w is row ``w * body_count + b`` of newton's arrays.

        Raises:
            InputError: Several worlds, or some that differ; something that is neither.
        """
        newton = newton_module()
        if isinstance(source, newton.ModelBuilder):
            _check_masses(source)
            try:
                source = source.finalize(device="cpu")
            except ValueError as error:
                raise InputError(f"newton cannot finalise the builder: {error}") from None
        if not isinstance(source, newton.Model):
            raise InputError(
                f"a newton.ModelBuilder or newton.Model is needed, got {type(source).__name__}"
            )
        if source.world_count > 1 and not worlds:
            raise InputError(
                f"the model has {source.world_count} worlds: import one and repeat it here, "
                "Scene(env_count=...)"
            )
        self.newton = newton
        self.model = source
        self._arrays: dict[str, np.ndarray] = {}
        self.world_count = max(int(source.world_count), 1)
        self.body_count = int(source.body_count) // self.world_count
        """Bodies of a world."""
        if self.world_count > 1:
            self._check_worlds()
        self.bodies = short_names(source.body_label[: self.body_count])
        """Names of the bodies."""
        self.joints = short_names(source.joint_label)
        """Names of the joints."""

    def array(self, name: str) -> np.ndarray:
        """An array of the model, floats as float64; with no rows where the model has none.

        Raises InputError for what is not finite, as a robot's file may say; limits alone may be
        infinite.
        """
        if name not in self._arrays:
            self._arrays[name] = self._on_host(name)
            self._arrays[name].setflags(write=False)
        return self._arrays[name]

    def _on_host(self, name: str) -> np.ndarray:
        value = getattr(self.model, name)
        if value is None:
            return np.zeros(0)
        host = np.array(value.numpy())
        if host.dtype != np.float32:
            return host
        wrong = np.isnan(host) if "limit" in name else ~np.isfinite(host)
        if wrong.any():
            raise InputError(
                f"{name} of the model has to be finite, got {host[wrong].flat[0]:g} in row "
                f"{np.argwhere(wrong)[0][0]}"
            )
        return host.astype(np.float64)

    @cached_property
    def body_q(self) -> np.ndarray:
        """Where the bodies are at the model's own joint coordinates, [body, 7]."""
        return unit_poses(self.array("body_q").reshape(-1, 7))

    @cached_property
    def mimics(self) -> dict[int, tuple[int, float, float]]:
        """Leader, offset and factor of each joint that follows another one: those of newton's
        joints, and its constraints, which its reader of MJCF makes."""
        found: dict[int, tuple[int, float, float]] = {}
        for i, leader in enumerate(self.array("joint_mimic_joint")):
            if leader >= 0:
                offset, factor = self.array("joint_mimic_coeffs")[i].tolist()
                found[i] = (int(leader), offset, factor)
        if self.model.constraint_mimic_count:
            ends = [self.array(f"constraint_mimic_joint{k}").astype(int) for k in range(2)]
            terms = [self.array(f"constraint_mimic_coef{k}") for k in range(2)]
            for row in np.flatnonzero(self.array("constraint_mimic_enabled")):
                found[int(ends[0][row])] = (
                    int(ends[1][row]), float(terms[0][row]), float(terms[1][row]),
                )  # fmt: skip
        return found

    def free_bodies(self) -> list[int]:
        """Bodies that nothing but a free joint of the world carries, and that carry nothing."""
        kinds, parents = self.array("joint_type"), self.array("joint_parent")
        free = int(self.newton.JointType.FREE)
        held = self.array("joint_child")[(kinds != free) | (parents >= 0)]
        busy = set(held.tolist()) | set(parents.tolist())
        return [i for i in range(self.body_count) if i not in busy]

    def is_kinematic(self, body: int) -> bool:
        """Whether newton leaves the pose of a body to the user."""
        return bool(self.array("body_flags")[body] & int(self.newton.BodyFlags.KINEMATIC))

    def body_id(self, name: str) -> int:
        """Index of a body by its name or its newton label; InputError for one that is not there."""
        for names in (self.bodies, self.model.body_label[: self.body_count]):
            if name in names:
                return list(names).index(name)
        raise InputError(f"there is no body {name!r}{unknown(name, self.bodies)}")

    def _check_worlds(self) -> None:
        """Refuse worlds that are not copies of the first one, but for where they stand."""
        count = self.body_count
        worlds = np.arange(self.world_count)
        if not np.array_equal(self.array("body_world"), np.repeat(worlds, count)):
            raise InputError(
                "a model of several worlds needs the same bodies in each, and none outside them: "
                "make it by ModelBuilder.replicate"
            )
        for what, (names, carriers) in _OF_WORLDS.items():
            own = self.array(f"{what}_world").astype(int)
            for name in (*names, *carriers):
                array = self.array(name)
                if name in carriers:
                    array = np.where(array >= 0, array - count * np.maximum(own, 0), array)
                if name == "shape_transform":
                    # What stands in a world itself moves with the world.
                    array = np.where(self.array("shape_body")[:, None] >= 0, array, 0.0)
                for world in worlds:
                    if not np.array_equal(array[own == world], array[own == 0]):
                        raise InputError(
                            f"world {world} differs from world 0 in its {name}: worlds must be "
                            "copies, make them by ModelBuilder.replicate"
                        )
        gravity = self.array("gravity")
        if (gravity != gravity[:1]).any():
            raise InputError("all worlds must have the same gravity")


def _check_masses(builder: Any) -> None:
    """Refuse masses that newton would leave out, with a warning, when it finalises the builder."""
    for label, mass, inertia in zip(
        builder.body_label, builder.body_mass, builder.body_inertia, strict=True
    ):
        if not (math.isfinite(mass) and mass >= 0 and np.isfinite(np.array(inertia)).all()):
            raise InputError(
                f"body {label!r} has a mass of {mass:g} kg: mass and inertia have to be finite, "
                "and mass at least 0"
            )


_OF_WORLDS = {
    "body": (("body_mass", "body_com", "body_inertia", "body_flags"), ()),
    "joint": (("joint_type",), ("joint_parent", "joint_child")),
    "shape": (
        ("shape_type", "shape_scale", "shape_flags", "shape_material_mu", "shape_transform"),
        ("shape_body",),
    ),
}
"""Arrays of bodies, joints and shapes that are the same in all worlds, and those that hold indices
of bodies."""


def unit_poses(poses: np.ndarray) -> np.ndarray:
    """Poses [..., 7] in double precision with quaternions of unit length: FP32 ones are off by
    1e-7, which no rotation is."""
    poses = np.array(poses, dtype=np.float64)
    lengths = np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    if not (lengths > 0).all():
        raise InputError("a rotation of the model is a quaternion of length 0")
    poses[..., 3:] /= lengths
    return poses


def short_names(labels: list[str]) -> list[str]:
    """The last parts of labels such as "robot/worldbody/hand" that tell them from the others."""
    parts = [label.split("/") for label in labels]
    names = []
    for i, own in enumerate(parts):
        others = parts[:i] + parts[i + 1 :]
        count = 1
        while count < len(own) and any(own[-count:] == other[-count:] for other in others):
            count += 1
        names.append("/".join(own[-count:]))
    for i, name in enumerate(names):
        if names.index(name) != i:
            names[i] = f"{name} {i}"
    return names


def rigid_motion(
    y: np.ndarray, v: np.ndarray, solid: MassProperties
) -> tuple[np.ndarray, np.ndarray]:
    """Poses [n, 7], and velocities of the centre with angular velocities [n, 6], of the rotations
    nearest to an affine body's maps; ``y``, ``v``: its control nodes, [n, 4, 3]."""
    affine = y[:, 1:].swapaxes(1, 2) @ solid.axes.T / solid.radius_m
    rate = v[:, 1:].swapaxes(1, 2) @ solid.axes.T / solid.radius_m @ np.linalg.inv(affine)
    left, _, right = np.linalg.svd(affine)
    place = np.tile(np.eye(4), (len(y), 1, 1))
    place[:, :3, :3] = left @ right
    place[:, :3, 3] = y[:, 0] - place[:, :3, :3] @ solid.center_m
    skew = (rate - rate.swapaxes(1, 2)) / 2
    spin = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    return pose_of(place), np.concatenate([v[:, 0], spin], axis=1)
