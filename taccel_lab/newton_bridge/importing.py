# SPDX-License-Identifier: Apache-2.0
"""A newton model as a robot and bodies of ours.

What is fixed to newton's world, or carried by joints that are, is one robot whose base is the link
``world``. Bodies on free joints are affine bodies. What is left out: visuals and sites, stiffness,
damping and friction of joints and drives, contact stiffnesses (ours do not penetrate), friction of
links (``Robot.link_friction``), collision filters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError
from taccel_lab.newton_bridge.joints import WORLD, joint_chain
from taccel_lab.newton_bridge.newton_model import NewtonModel, unit_poses
from taccel_lab.newton_bridge.shapes import (
    affine_body,
    collision_shapes,
    is_plane,
    touching_shapes,
)
from taccel_lab.newton_bridge.soft_bodies import soft_bodies
from taccel_lab.robots import Robot
from taccel_lab.robots.description import Link, LinkMass, RobotJoint
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.scene import AffineBody, Plane, SoftBody


@dataclass(frozen=True, eq=False)
class NewtonScene:
    """What a newton model holds, for ``Scene``."""

    robot: Robot | None
    """All that stands on newton's world, with the gels that its links carry; None for nothing."""
    affine_bodies: list[AffineBody]
    """Bodies that move freely, where the model's joint coordinates have them."""
    soft_bodies: list[SoftBody]
    """Soft bodies that no link carries."""
    planes: list[Plane]
    gravity_m_s2: tuple[float, float, float]
    start_q: np.ndarray
    """Coordinates of ``robot`` where the model starts, [dof]."""


def import_model(source: Any, *, name: str = "newton") -> NewtonScene:
    """A ``newton.ModelBuilder`` or ``newton.Model`` as bodies of ours.

    Args:
        source: With one world.
        name: Of the robot.

    Raises:
        InputError: Names what cannot be taken over: balls and other joints, loops, floating robots,
            height fields and other shapes, bodies that move freely without mass or with several
            shapes, muscles, tendons, springs, cloth and loose particles, gels on bodies that move
            freely. Also where newton is not installed.
    """
    model = NewtonModel(source)
    if model.model.tendon_count:
        raise InputError(f"the model has {model.model.tendon_count} tendons: these are not taken")
    free = model.free_bodies()
    for i in free:
        if model.is_kinematic(i):
            raise InputError(
                f"body {model.bodies[i]!r} is kinematic and on no joint: make it a "
                "KinematicBody of the scene"
            )
    robot, start_q = _robot(model, free, name)
    loose = []
    for made in soft_bodies(model):
        if made.body < 0:
            loose.append(made.gel)
            continue
        carrier = model.bodies[made.body]
        if made.body in free or robot is None:
            raise InputError(
                f"{made.gel.name} is attached to {carrier!r}, which moves freely: gels are carried "
                "by links of a robot"
            )
        robot = robot.mount(carrier, made.gel, name=made.gel.name)
    x, y, z = model.array("gravity")[-1].tolist()
    return NewtonScene(
        robot,
        [affine_body(model, i, model.body_q[i]) for i in free],
        loose,
        world_planes(model),
        (x, y, z),
        start_q,
    )


def _robot(model: NewtonModel, free: list[int], name: str) -> tuple[Robot | None, np.ndarray]:
    """Everything but the free bodies, and its coordinates at the start."""
    links = [Link(WORLD, collision_shapes(model, -1))]
    links += [_link(model, i) for i in range(model.model.body_count) if i not in free]
    joints: list[RobotJoint] = []
    start: dict[str, float] = {}
    for i in range(model.model.joint_count):
        if int(model.array("joint_child")[i]) in free:
            continue
        between, made = joint_chain(model, i)
        links += between
        joints += made
        first = int(model.array("joint_q_start")[i])
        moving = [joint for joint in made if joint.kind is not JointKind.FIXED]
        values = model.array("joint_q")[first : first + len(moving)]
        start |= dict(zip([joint.name for joint in moving], values.tolist(), strict=True))
    if len(links) == 1 and not links[0].shapes:
        return None, np.zeros(0)
    robot = Robot(name, tuple(links), tuple(joints))
    return robot, np.array([start[dof] for dof in robot.dof_names])


def _link(model: NewtonModel, body: int) -> Link:
    mass = float(model.array("body_mass")[body])
    known = None
    if mass > 0:
        known = LinkMass(mass, model.array("body_com")[body], model.array("body_inertia")[body])
    if model.bodies[body] == WORLD:
        raise InputError(f"a body is called {WORLD!r}, as newton's world is here: rename it")
    return Link(model.bodies[body], collision_shapes(model, body), known)


def world_planes(model: NewtonModel) -> list[Plane]:
    """The endless planes of newton's world.

    Raises InputError where those of several worlds are not the same.
    """
    own = model.array("shape_world")
    found = [i for i in touching_shapes(model, -1) if is_plane(model, i)]
    planes = {int(i): _plane(model, i) for i in found}
    first = [planes[i] for i in found if own[i] <= 0]
    levels = {
        world: [_level(planes[i]) for i in found if own[i] == world]
        for world in range(model.world_count)
    }
    for world, level in levels.items():
        if not np.allclose(level, levels[0], rtol=0, atol=1e-6):
            raise InputError(f"planes of world {world} are not where those of world 0 are")
    return first


def _level(plane: Plane) -> np.ndarray:
    """Normal, and distance from the origin [m], [4]."""
    return np.array([*plane.normal, np.dot(plane.normal, plane.point_m)])


def _plane(model: NewtonModel, shape: int) -> Plane:
    place = matrix_of(unit_poses(model.array("shape_transform")[shape]))
    x, y, z = place[:3, 3].tolist()
    a, b, c = place[:3, 2].tolist()
    return Plane(
        (x, y, z),
        (a, b, c),
        float(model.array("shape_material_mu")[shape]),
        name=model.model.shape_label[shape],
    )
