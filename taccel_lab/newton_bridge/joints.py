# SPDX-License-Identifier: Apache-2.0
"""Newton's joints as those of a robot.

With the joint's frame X_p in the parent and X_c in the child, newton has
``world_from_child = world_from_parent X_p J(q) X_c^-1``. A robot's joint ends in the frame of its
child, so that this is written ``(X_p X_c^-1) (X_c J X_c^-1)``: a slide along, or a turn about, the
axis as the child has it. Where that axis does not go through the child's origin, or where a joint
has several axes, links without mass or shape stand between.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError
from taccel_lab.newton_bridge.newton_model import NewtonModel, unit_poses
from taccel_lab.robots.description import Link, Mimic, RobotJoint
from taccel_lab.robots.transforms import matrix_of

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
