# SPDX-License-Identifier: Apache-2.0
"""A robot that is moved by drives: links with mass as affine bodies, joints with limits and drives.

Links that fixed joints connect are one group. A group has an affine body for each collision shape,
held together by fixed joints. Together they have the mass, centre and inertia that the file states
of its links, or of its shapes where it states none; each has a share by its volume, about the
group's centre. A gel is mounted on one of them, and weighs on it beside that. The base goes where
it is commanded: its shapes are kinematic bodies, and what it carries is mounted on the first of
them. Links do not touch one another unless the robot touches itself.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taccel_lab.bodies.bodies import ALL_LAYERS
from taccel_lab.bodies.joints import Drive, Joint, JointKind
from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.errors import InputError, InputWarning
from taccel_lab.guards import require_known, require_shape
from taccel_lab.robots.description import LinkMass, RobotJoint, listed
from taccel_lab.robots.mounts import GEL_LAYER, LINK_LAYER
from taccel_lab.robots.robot import IDENTITY_POSE, Robot
from taccel_lab.robots.self_contact import on_surfaces, overlapping, require_apart, rigid_groups
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import (
    AffineBody,
    Ball,
    FixedJoint,
    KinematicBody,
    PrismaticJoint,
    RevoluteJoint,
    Scene,
    SoftBody,
    StatedMass,
    Surface,
    TimeStepping,
    TriangleMesh,
    sphere_mesh,
)

SURFACE = Surface(layer=LINK_LAYER, collides_with=ALL_LAYERS & ~(LINK_LAYER | GEL_LAYER))
BALL_EDGE = 0.25
"""Edge of the mesh of a ball that moves freely, over its radius."""
DENSITY = 1000.0
"""Density of links that state no mass [kg/m^3]: that of affine bodies, about what plastic has."""
SLIMMEST = 1e-3
"""Smallest second moment of a link over its largest one, where an inertia is of no solid: a rod
thirty times as long as wide has it."""


@dataclass(frozen=True, eq=False)
class DrivenRobot:
    """What of a robot goes into a scene with inertia (``TimeStepping(quasi_static=False)``)."""

    robot: Robot
    start_q: np.ndarray
    """Coordinates that the scene starts at, where the coordinates of its joints are 0, [dof]."""
    affine_bodies: list[AffineBody]
    """Bodies for ``Scene(affine_bodies=)``."""
    soft_bodies: list[SoftBody]
    """Its gels, for ``Scene(soft_bodies=)``."""
    kinematic_bodies: list[KinematicBody]
    """Shapes of the base and frames of its gels, for ``Scene(kinematic_bodies=)``; where it has
    neither, a frame for the joints that it carries."""
    joints: list[Joint]
    """Joints for ``Scene(joints=)``; those that move are called as the robot's."""
    base: Robot
    """The robot with the shapes and gels alone of what does not move."""

    def poses(self, env_count: int, world_from_base: Any = None) -> np.ndarray:
        """Poses of ``kinematic_bodies``, [env_count, body, 7]: ``Control.target_poses``. They stay,
        or take all that they carry to ``world_from_base``, [7] or [env_count, 7]."""
        if world_from_base is None:
            world_from_base = self.robot.world_from_base
        at = np.asarray(world_from_base, dtype=np.float64)
        require_shape("world_from_base", at, (7,), (env_count, 7))
        turned = matrix_of(np.broadcast_to(at, (env_count, 7)))
        return pose_of(turned[:, None] @ matrix_of(_of_base(self.base, self.start_q)))

    def joint_targets(self, q: Any) -> np.ndarray:
        """``Control.joint_targets`` of position drives for coordinates [n, dof], [n, joint].

        The order is that of ``joints``; those without a drive have 0. Targets may lie beyond the
        limits: a drive then pushes against them.
        """
        rows = np.atleast_2d(np.asarray(q, dtype=np.float64))
        if rows.ndim != 2 or rows.shape[1] != self.robot.dof or not np.isfinite(rows).all():
            raise InputError(
                f"coordinates must be finite, [n, {self.robot.dof}] "
                f"({listed(self.robot.dof_names)}), got shape {np.shape(q)}"
            )
        tree = self.robot.tree
        moved = (rows - self.start_q) @ tree.factors.T
        column = {joint.name: i for i, joint in enumerate(self.robot.joints) if joint.moves}
        ids = [column.get(joint.name, -1) for joint in self.joints]
        return np.where(np.array(ids) >= 0, moved[:, ids], 0.0)

    def coordinates(self, joints: Any) -> np.ndarray:
        """Coordinates [n, dof] of the scene's, ``solver.joints.coordinates.numpy()`` [n, joint];
        columns behind those of ``joints`` are of others."""
        values = np.asarray(joints, dtype=np.float64)
        names = [joint.name for joint in self.joints]
        return self.start_q + values[:, [names.index(name) for name in self.robot.dof_names]]


def drive(
    robot: Robot,
    drives: Drive | Mapping[str, Drive],
    start_q: Any = None,
    *,
    closest_inertia: bool = False,
) -> DrivenRobot:
    """A robot as bodies and joints that its drives move.

    A joint that mimics another one follows it by the target of its own drive, not by force. Links
    of a robot that touches itself (``Robot.touching_itself``) touch one another.

    Args:
        robot: Its base stands where ``world_from_base`` says.
        drives: Of each joint that moves, by name, also of those that mimic others; joints that are
            not named are free. One for all is given the largest effort that the file states for
            each joint.
        start_q: Coordinates to start at, [dof]; ``rest_q`` when None.
        closest_inertia: Take the closest inertia of a solid where the file states one of none, as
            many do, instead of refusing it.

    Raises:
        InputError: A part that moves without collision shape or mass or with an inertia of no
            solid, a drive of an unknown joint, coordinates out of the limits, a shape without
            inside, or links that touch one another and overlap at the start.
    """
    q = robot.rest_q if start_q is None else np.asarray(start_q, dtype=np.float64)
    require_shape("start_q", q, (robot.dof,))
    groups = rigid_groups(robot.link_names, robot.joints)
    robot.targets(q)  # Refuses coordinates out of the limits.
    fixed = [name for name, top in groups.items() if top == robot.base]
    base = robot.touching(fixed)
    base = replace(base, mounts=tuple(mount for mount in robot.mounts if mount.link in fixed))
    frames = base.kinematic_bodies() or [KinematicBody(None, name=f"{robot.name}/base")]
    hung = frames[0].name, matrix_of(robot.world_from_base) @ matrix_of(_of_base(base, q)[0])
    moving = [joint.name for joint in robot.joints if joint.moves]
    if isinstance(drives, Mapping):
        for name in drives:
            require_known("joint to drive", name, moving)
    poses = dict(zip(robot.link_names, robot.forward_kinematics(q)[0], strict=True))
    bodies: list[AffineBody] = []
    joints: list[Joint] = []
    carriers: dict[str, str] = {}
    starts: list[np.ndarray] = []
    for group in dict.fromkeys(groups.values()):
        if group == robot.base:
            continue
        links = [name for name, of in groups.items() if of == group]
        made = _group_bodies(robot, group, links, poses, closest_inertia)
        carriers[group] = made[0].name
        bodies += made
        starts += [np.asarray(body.initial_pose) for body in made]
        joints += [
            FixedJoint(body.name, made[0].name, tuple(poses[group][:3]), name=f"{body.name}: bond")
            for body in made[1:]
        ]
    values = robot.tree.factors @ q + robot.tree.offsets
    for joint, value in zip(robot.joints, values, strict=True):
        if joint.moves:
            parent = carriers.get(groups[joint.parent])
            world = matrix_of(poses[joint.child])
            chosen = drives.get(joint.name) if isinstance(drives, Mapping) else _own(drives, joint)
            made_joint = _joint(joint, carriers[joint.child], parent, world, float(value), chosen)
            if parent is None:
                made_joint = replace(made_joint, second=hung[0], second_pose=pose_of(hung[1]))
            joints.append(made_joint)
    names = [body.name for body in bodies]
    gels = []
    for mount in robot.mounts:
        gel = mount.gel
        if mount.link not in fixed:
            # A body of its own link, or the first one of those that move with it as one.
            own = [f"{robot.name}/{mount.link}", f"{robot.name}/{mount.link}/0"]
            carrier = next((name for name in own if name in names), carriers[groups[mount.link]])
            body_from_world = np.linalg.inv(matrix_of(starts[names.index(carrier)]))
            pose = body_from_world @ matrix_of(poses[mount.link]) @ mount.link_from_gel
            gel = replace(gel, mount=carrier, mount_pose=pose_of(pose))
        gels.append(gel)
    made = DrivenRobot(robot, q, bodies, gels, frames, joints, base)
    return made if robot.apart is None else _touching_itself(made)


def _touching_itself(driven: DrivenRobot) -> DrivenRobot:
    """Adds the surfaces of a robot that touches itself; InputError where it overlaps itself."""
    robot = driven.robot
    links = {}
    for body in (*driven.affine_bodies, *driven.kinematic_bodies):
        if body.shape is not None:
            name = body.name.removeprefix(f"{robot.name}/")
            links[body.name] = name if name in robot.link_names else name.rpartition("/")[0]
    found = robot.surfaces(links)
    made = replace(
        driven,
        affine_bodies=on_surfaces(driven.affine_bodies, found),
        soft_bodies=on_surfaces(driven.soft_bodies, found),
        kinematic_bodies=on_surfaces(driven.kinematic_bodies, found),
    )
    scene = Scene(
        made.soft_bodies,
        made.kinematic_bodies,
        time=TimeStepping(quasi_static=False),
        affine_bodies=made.affine_bodies,
        joints=made.joints,
    )
    require_apart(overlapping(scene, made.poses(1), robot.parts(links)), robot.name)
    return made


def _of_base(base: Robot, q: np.ndarray) -> np.ndarray:
    """Poses of the base's bodies in the base, [body, 7]; of the frame of one without any."""
    if not base.kinematic_bodies():
        return IDENTITY_POSE[None]
    return replace(base, world_from_base=IDENTITY_POSE).targets(q)[0]


def _own(drive: Drive, joint: RobotJoint) -> Drive:
    return replace(drive, max_effort=min(drive.max_effort, joint.max_effort))


def _group_bodies(
    robot: Robot, group: str, links: list[str], poses: Mapping[str, np.ndarray], closest: bool
) -> list[AffineBody]:
    """Bodies of links that move as one."""
    shapes: list[tuple[str, TriangleMesh]] = []
    masses: list[tuple[LinkMass, np.ndarray]] = []
    for name in links:
        link = robot.links[robot.link_id(name)]
        if link.mass is not None:
            masses.append((link.mass, matrix_of(poses[name])))
        for shape in link.shapes:
            surface, offset = shape.surface()
            if isinstance(surface, Ball):
                ball = sphere_mesh(surface.radius_m, BALL_EDGE * surface.radius_m)
                surface = TriangleMesh(ball.vertices_m + offset[:3, 3], ball.faces)
            shapes.append((name, surface))
    if not shapes:
        raise InputError(
            f"link {group!r} moves but has no collision shape: a body that drives move needs one"
        )
    solids = [mass_properties(mesh, DENSITY) for _, mesh in shapes]
    volumes = np.array([solid.volume_m3 for solid in solids])
    if not masses:
        masses = [
            (LinkMass(solid.mass_kg, solid.center_m, solid.inertia_kg_m2), matrix_of(poses[name]))
            for (name, _), solid in zip(shapes, solids, strict=True)
        ]
        warnings.warn(
            f"link {group!r} states no mass: its shapes filled with {DENSITY:g} kg/m^3 weigh "
            f"{sum(solid.mass_kg for solid in solids):.3g} kg",
            InputWarning,
            stacklevel=4,
        )
    total = _total(masses)
    if closest:
        total = replace(total, inertia_kg_m2=closest_solid(total.inertia_kg_m2))
    bodies = []
    for i, ((name, mesh), share) in enumerate(zip(shapes, volumes / volumes.sum(), strict=True)):
        back = np.linalg.inv(matrix_of(poses[name]))
        turn = back[:3, :3]
        try:
            mass = StatedMass(
                share * total.mass_kg,
                turn @ total.center_m + back[:3, 3],
                share * (turn @ total.inertia_kg_m2 @ turn.T),
            )
        except InputError as error:
            raise InputError(
                f"link {group!r}: {error}; drive(closest_inertia=True) takes the closest one"
            ) from None
        bodies.append(
            AffineBody(
                mesh,
                name=f"{robot.name}/{name}" + (f"/{i}" if len(shapes) > 1 else ""),
                friction_coefficient=robot.link_friction,
                surface=SURFACE,
                initial_pose=poses[name],
                stated_mass=mass,
            )
        )
    return bodies


def closest_solid(inertia: np.ndarray) -> np.ndarray:
    """An inertia [3, 3] whose second moments, tr(I) / 2 - I, are none below ``SLIMMEST`` times the
    largest one: the same where they are not."""
    moments, axes = np.linalg.eigh(np.trace(inertia) / 2 * np.eye(3) - inertia)
    moments = np.maximum(moments, SLIMMEST * moments.max())
    return (axes * (moments.sum() - moments)) @ axes.T


def _total(parts: list[tuple[LinkMass, np.ndarray]]) -> LinkMass:
    """Mass, centre and inertia in the world of parts, each with its world_from_part [4, 4]."""
    centers = [place[:3, :3] @ part.center_m + place[:3, 3] for part, place in parts]
    mass = sum(part.mass_kg for part, _ in parts)
    center = np.sum(
        [part.mass_kg * at for (part, _), at in zip(parts, centers, strict=True)], axis=0
    )
    center = center / mass
    inertia = np.zeros((3, 3))
    for (part, place), at in zip(parts, centers, strict=True):
        arm = at - center
        inertia += place[:3, :3] @ part.inertia_kg_m2 @ place[:3, :3].T
        inertia += part.mass_kg * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return LinkMass(mass, center, inertia)


def _joint(
    joint: RobotJoint,
    child: str,
    parent: str | None,
    world: np.ndarray,
    value: float,
    drive: Drive | None,
) -> Joint:
    """A joint of the scene, at 0 where the robot's is at ``value``; ``world`` is its child's frame.

    A slide's origin and its child's differ along the axis only, a hinge's not at all.
    """
    anchor, axis = tuple(world[:3, 3]), tuple(world[:3, :3] @ joint.axis)
    low, high = min(joint.lower - value, 0.0), max(joint.upper - value, 0.0)
    if joint.lower == joint.upper:
        return FixedJoint(child, parent, anchor, name=joint.name)
    limited = math.isfinite(low) or math.isfinite(high)
    if joint.kind is JointKind.PRISMATIC:
        limits = (low * 1e3, high * 1e3) if limited else None
        return PrismaticJoint(
            child, parent, anchor, axis, name=joint.name, limits_mm=limits, drive=drive
        )
    degrees = (math.degrees(low), math.degrees(high)) if limited else None
    return RevoluteJoint(
        child, parent, anchor, axis, name=joint.name, limits_deg=degrees, drive=drive
    )
