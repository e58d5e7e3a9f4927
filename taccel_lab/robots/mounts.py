# SPDX-License-Identifier: Apache-2.0
"""Links as kinematic bodies of a scene, and gels on them.

A gel stands on a frame without a surface, a body that moves with the link; its bonded
nodes follow that exactly (``SoftBody.mount``). Gels and links do not touch one another, whichever
robot they belong to: pads are glued to links, and cut into their shapes. Both touch everything
else, and gels touch gels. Robots that touch themselves are another matter (``self_contact``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.bodies.bodies import ALL_LAYERS
from taccel_lab.errors import InputError
from taccel_lab.exporters.frames import LINK_FROM_GEL
from taccel_lab.geometry import TetMesh
from taccel_lab.presses.profile_gel import profile_gel
from taccel_lab.robots.description import Link
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import KinematicBody, SoftBody, Surface

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile

LINK_LAYER, GEL_LAYER = 1 << 29, 1 << 30
"""Collision layers of links and of gels on them."""
LINK_SURFACE = Surface(layer=LINK_LAYER, collides_with=ALL_LAYERS & ~GEL_LAYER)
GEL_SURFACE = Surface(layer=GEL_LAYER, collides_with=ALL_LAYERS & ~LINK_LAYER)
TOUCHING_SURFACES = Surface(layer=LINK_LAYER), Surface(layer=GEL_LAYER)
"""Surfaces of links and gels of a robot that touches itself."""


def on_seat(mesh: TetMesh) -> np.ndarray:
    """link_from_gel, [7], that lays a gel's back (its lowest z) on the plane x = 0 of a link.

    The contact face looks along the link's x axis, and the image's right and down are -y and -z,
    as in the exported ``sensor_link``: the seats of our robots are made for it.
    """
    pose = np.eye(4)
    pose[:3, :3] = LINK_FROM_GEL
    pose[0, 3] = -mesh.nodes_m[:, 2].min()
    return pose_of(pose)


@dataclass(frozen=True)
class Mount:
    """A gel on a link."""

    link: str
    gel: SoftBody
    """Gel in the gel frame."""
    link_from_gel: np.ndarray
    """Where the gel frame is in the link, [4, 4]."""


@dataclass(frozen=True)
class CarriedBody:
    """A body of the scene that a link carries."""

    link: str
    body: KinematicBody
    link_from_body: np.ndarray
    """[4, 4]."""


def make_mount(
    robot: str, link: str, gel: SensorProfile | SoftBody, pose: np.ndarray, name: str
) -> Mount:
    """A gel on a link of a robot; ``pose``: link_from_gel, [7]."""
    if isinstance(gel, SoftBody):
        if gel.mount is not None or gel.initial_pose is not None:
            raise InputError(f"gel {gel.name!r} already has a mount or a pose; give one without")
        surface = gel.surface
        body = replace(gel, surface=GEL_SURFACE if surface == Surface() else surface)
    else:
        body = profile_gel(gel, surface=GEL_SURFACE)
    body = replace(body, name=name, mount=f"{robot}/{link}: mount of {name}")
    return Mount(link, body, matrix_of(pose))


def carried_bodies(
    robot: str, links: tuple[Link, ...], mounts: tuple[Mount, ...], friction: float | None
) -> list[CarriedBody]:
    """Frames of mounts, then shapes of links: a body each. What has neither costs nothing."""
    found = [
        CarriedBody(mount.link, KinematicBody(None, name=str(mount.gel.mount)), mount.link_from_gel)
        for mount in mounts
    ]
    for link in links:
        for i, shape in enumerate(link.shapes):
            name = f"{robot}/{link.name}" + (f"/{i}" if len(link.shapes) > 1 else "")
            surface, link_from_body = shape.surface()
            body = KinematicBody(surface, friction, name=name, surface=LINK_SURFACE)
            found.append(CarriedBody(link.name, body, link_from_body))
    return found
