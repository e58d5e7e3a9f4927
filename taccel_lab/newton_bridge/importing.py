# SPDX-License-Identifier: Apache-2.0
"""A newton model as a robot and bodies of ours.

What is fixed to newton's world, or carried by joints that are, is one robot whose base is the link
``world``. Bodies on free joints are affine bodies. What is left out: visuals and sites, stiffness,
damping and friction of joints and drives, contact stiffnesses (ours do not penetrate), friction of
links (``Robot.link_friction``), collision filters.

With a joint's frame X_p in the parent and X_c in the child, newton has
``world_from_child = world_from_parent X_p J(q) X_c^-1``. A robot's joint ends in the frame of its
child, so that this is written ``(X_p X_c^-1) (X_c J X_c^-1)``: a slide along, or a turn about, the
axis as the child has it. Where that axis does not go through the child's origin, or where a joint
has several axes, links without mass or shape stand between.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError
from taccel_lab.newton_bridge.newton_model import NewtonModel, unit_poses
from taccel_lab.newton_bridge.shapes import (
    affine_body,
    collision_shapes,
    is_plane,
    touching_shapes,
)
from taccel_lab.newton_bridge.soft_bodies import soft_bodies
from taccel_lab.robots import Robot
from taccel_lab.robots.description import Link, LinkMass, Mimic, RobotJoint
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.scene import AffineBody, Plane, SoftBody

WORLD = "world"
"""Name of the link that stands for newton's world."""
NO_LIMIT = 1e9
"""Bound beyond which a coordinate has no limit: newton writes 1e10."""
NO_EFFORT_LIMIT = 1e6
"""Force from which a drive has no limit, newton's default."""


def joint_chain(source: NewtonModel, joint: int) -> tuple[list[Link], list[RobotJoint]]:
    """Links in between, and joints, that stand for one of newton's.

    Raises InputError, with the joint's name, for a joint that is free, a ball, a distance or a rod,
    and for one that is switched off.
    """
    kinds = source.newton.JointType
    kind = kinds(int(source.array("joint_type")[joint]))
    name = source.joints[joint]
    if kind not in (kinds.FIXED, kinds.REVOLUTE, kinds.PRISMATIC, kinds.D6):
        raise InputError(
            f"joint {name!r} is a {kind.name.lower()} joint: fixed, revolute and prismatic ones, "
            "and D6 of those, can be taken over"
            + ("; a robot's base stands still (floating=False)" if kind is kinds.FREE else "")
        )
    if not source.array("joint_enabled")[joint]:
        raise InputError(f"joint {name!r} is switched off")
    parent = int(source.array("joint_parent")[joint])
    child = source.bodies[int(source.array("joint_child")[joint])]
    frame = matrix_of(unit_poses(source.array("joint_X_p")[joint]))
    in_child = matrix_of(unit_poses(source.array("joint_X_c")[joint]))
    links: list[Link] = []
    joints: list[RobotJoint] = []
    carrier = WORLD if parent < 0 else source.bodies[parent]
    motions = coordinate_names(source, joint)
    for k, motion in enumerate(motions):
        slides = k < int(source.array("joint_dof_dim")[joint][0])
        made = _motion(source, joint, k, motion, slides)
        axis = in_child[:3, :3] @ made.axis
        last = k == len(motions) - 1
        if last and (slides or _through_origin(in_child[:3, 3], axis)):
            there = frame @ np.linalg.inv(in_child)
            joints.append(
                _placed(made, carrier, child, there, axis),
            )
            return links, joints
        between = f"frame of {motion}"
        links.append(Link(between))
        joints.append(_placed(made, carrier, between, frame, made.axis))
        carrier, frame = between, np.eye(4)
    fixed = f"{name} to {child}" if motions else name
    end = RobotJoint(
        fixed, JointKind.FIXED, carrier, child, frame @ np.linalg.inv(in_child), np.eye(3)[2]
    )
    return links, [*joints, end]


def coordinate_names(source: NewtonModel, joint: int) -> list[str]:
    """A name for each axis of a joint: its own, or with a number where there are several."""
    name = source.joints[joint]
    count = int(source.array("joint_dof_dim")[joint].sum())
    return [name] if count == 1 else [f"{name}/{k}" for k in range(count)]


def _through_origin(point: np.ndarray, axis: np.ndarray) -> bool:
    """Whether an axis through a point passes the origin, to the rounding of FP32."""
    return bool(np.linalg.norm(np.cross(point, axis)) <= 1e-7 * np.linalg.norm(point))


def _motion(source: NewtonModel, joint: int, k: int, motion: str, slides: bool) -> RobotJoint:
    """Axis, limits, effort and leader of one axis; ends and frame are still to be given."""
    dof = int(source.array("joint_qd_start")[joint]) + k
    axis = source.array("joint_axis")[dof]
    if not axis.any():
        raise InputError(f"axis of joint {motion!r} has no length")
    lower, upper = (float(source.array(f"joint_limit_{end}")[dof]) for end in ("lower", "upper"))
    effort = float(source.array("joint_effort_limit")[dof])
    mimic = None
    if joint in source.mimics:
        leader, offset, factor = source.mimics[joint]
        leaders = coordinate_names(source, leader)
        if len(leaders) != len(coordinate_names(source, joint)):
            raise InputError(f"joint {motion!r} mimics {source.joints[leader]!r} of other axes")
        mimic = Mimic(leaders[k], factor, offset)
    return RobotJoint(
        motion,
        JointKind.PRISMATIC if slides else JointKind.REVOLUTE,
        "",
        "",
        np.eye(4),
        axis / np.linalg.norm(axis),
        lower if lower > -NO_LIMIT else -math.inf,
        upper if upper < NO_LIMIT else math.inf,
        effort if 0 < effort < NO_EFFORT_LIMIT else math.inf,
        mimic,
    )


def _placed(
    joint: RobotJoint, parent: str, child: str, parent_from_joint: np.ndarray, axis: np.ndarray
) -> RobotJoint:
    return replace(
        joint, parent=parent, child=child, parent_from_joint=parent_from_joint, axis=axis
    )


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
