# SPDX-License-Identifier: Apache-2.0
"""Gels on newton's bodies, and what they touch, as a scene of ours.

A gel stands on a frame that moves with its body, as on a robot's link. What it touches is a body of
newton's that is prescribed here (a kinematic body for each of its shapes), or, if it moves freely
and shall be ``inside``, an affine body; and the endless planes of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.newton_bridge.importing import world_planes
from taccel_lab.newton_bridge.newton_model import NewtonModel
from taccel_lab.newton_bridge.shapes import affine_body, collision_shapes, touching_shapes
from taccel_lab.robots.mounts import Mount, make_mount
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import AffineBody, KinematicBody, Scene, SoftBody, TimeStepping

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class BodyGel:
    """A gel on a body of newton's."""

    body: str
    """Name or label of the body."""
    gel: SensorProfile | SoftBody
    """A sensor, or a gel in its own frame."""
    pose: Any = field(default_factory=lambda: np.array([0.0, 0, 0, 0, 0, 0, 1]))
    """body_from_gel, [7]."""
    name: str = ""
    """Name of the soft body; "gel of" the body when empty."""


class GelScene:
    """The bodies of ours that stand for newton's, and which is which."""

    def __init__(
        self,
        source: NewtonModel,
        gels: Sequence[BodyGel],
        touched: Sequence[str],
        inside: bool,
        dt_s: float,
    ) -> None:
        """
        Args:
            source: The model; each of its worlds is an environment.
            gels: On which bodies.
            touched: Names or labels of the bodies that gels may touch.
            inside: Whether those that move freely are unknowns of the scene.
            dt_s: Length of a step; each may have its own.

        Raises:
            InputError: No gel, an unknown body, one that carries a gel and is touched, a shape that
                cannot be taken over.
        """
        if not gels:
            raise InputError("at least one gel is needed")
        self.source = source
        self.mounts: list[Mount] = []
        """Gels on their frames, whose ``link`` is the name of newton's body."""
        self.frames: list[tuple[int, np.ndarray]] = []
        """Newton's body that each kinematic body moves with, and body_from_frame [4, 4]."""
        self.affine: list[int] = []
        """Newton's body of each affine body."""
        kinematic: list[KinematicBody] = []
        starts = source.body_q.reshape(source.world_count, -1, 7)
        free = source.free_bodies() if inside else []
        others = [source.body_id(label) for label in touched]
        for item in gels:
            carrier = source.body_id(item.body)
            if carrier in others:
                raise InputError(f"body {item.body!r} carries a gel: it cannot be touched, too")
            pose = np.asarray(item.pose, dtype=np.float64)
            name = item.name or f"gel of {item.body}"
            mount = make_mount("newton", source.bodies[carrier], item.gel, pose, name)
            self.mounts.append(mount)
            self.frames.append((carrier, mount.link_from_gel))
            kinematic.append(KinematicBody(None, name=str(mount.gel.mount)))
        affine: list[AffineBody] = []
        for body in others:
            if body in free and not source.is_kinematic(body):
                self.affine.append(body)
                affine.append(affine_body(source, body, starts[:, body]))
                continue
            rows = touching_shapes(source, body)
            for row, shape in zip(rows, collision_shapes(source, body), strict=True):
                surface, offset = shape.surface()
                friction = float(source.array("shape_material_mu")[row])
                name = source.model.shape_label[row]
                kinematic.append(KinematicBody(surface, friction, name=name))
                self.frames.append((body, offset))
        x, y, z = source.array("gravity")[-1].tolist()
        self.scene = Scene(
            [mount.gel for mount in self.mounts],
            kinematic,
            source.world_count,
            affine_bodies=affine,
            planes=world_planes(source),
            time=TimeStepping(quasi_static=False, dt_s=dt_s, gravity_m_s2=(x, y, z)),
        )

    def carried(self) -> list[int]:
        """Newton's body, of a world, that each of our bodies is, or rides on, in the order of their
        ids; -1 for planes."""
        soft = [body for body, _ in self.frames[: len(self.mounts)]]
        kinematic = [body for body, _ in self.frames]
        return [*soft, *self.affine, *kinematic, *(-1 for _ in self.scene.planes)]

    def targets(self, body_q: np.ndarray) -> np.ndarray:
        """Poses of the kinematic bodies, [world, frame, 7], of newton's bodies [world, body, 7]."""
        places = matrix_of(body_q[:, [body for body, _ in self.frames]])
        offsets = np.stack([offset for _, offset in self.frames])
        return pose_of(places @ offsets)
