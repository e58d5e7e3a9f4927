# SPDX-License-Identifier: Apache-2.0
"""A robot from a URDF file, read by yourdfpy (the extra ``robots``)."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError, InputWarning, naming
from taccel_lab.files.xml_file import read_xml
from taccel_lab.robots.description import Link, LinkMass, Mimic, RobotJoint
from taccel_lab.robots.robot import Robot
from taccel_lab.robots.shapes import (
    BoxShape,
    CollisionShape,
    CylinderShape,
    MeshShape,
    Shape,
    SphereShape,
)
from taccel_lab.robots.urdf_checks import checked_urdf, mesh_path

_KINDS = {
    "revolute": JointKind.REVOLUTE,
    "continuous": JointKind.REVOLUTE,
    "prismatic": JointKind.PRISMATIC,
    "fixed": JointKind.FIXED,
}
_UNIT_SLACK = 1e-3
"""How far the length of a slide's axis may be from 1: digits that were cut off."""


def load_urdf(
    path: Path | str,
    *,
    shapes: bool = True,
    packages: Mapping[str, Path | str] | None = None,
    as_drawn: bool = False,
) -> Robot:
    """A robot of the links, joints, limits, masses and collision shapes of a URDF file.

    Looks, transmissions and elements of other programs are left out.

    Args:
        path: The file.
        shapes: Whether collision shapes are read. Without them a robot has kinematics and gels, and
            its file may name meshes that cannot be read.
        packages: Folder of each package that meshes are named by, ``package://NAME/...``; those
            beside or above the file are found without.
        as_drawn: Whether ``up_axis`` of Collada meshes is left out, as RViz does.

    What is used otherwise than it stands is said by an ``InputWarning``: links whose mass is left
    out, drives without a limit of their effort, meshes that are turned.

    Raises:
        InputError: Names the file and what of it cannot be taken over: no XML, something missing
            or no number, joints that are planar or floating, loops, an axis of no length, collision
            meshes that are not there or not STL, PLY, OBJ or Collada. Also where yourdfpy is not
            installed.
    """
    path = Path(path)
    folders = {name: Path(folder) for name, folder in (packages or {}).items()}
    root = read_xml(path, "a URDF file")
    with naming(path):
        parsed = _parse(checked_urdf(root, shapes))
        return Robot(
            parsed.name,
            tuple(_link(link, path, folders, as_drawn) for link in parsed.links),
            tuple(_joint(joint) for joint in parsed.joints),
        )


def _parse(root: ElementTree.Element) -> Any:
    """yourdfpy's robot of a checked file."""
    try:
        from yourdfpy import URDF
    except ImportError:
        raise InputError(
            "robots are read by yourdfpy, which is not installed: pip install 'taccel-lab[robots]'"
        ) from None
    text = io.BytesIO(ElementTree.tostring(root))
    return URDF.load(text, build_scene_graph=False, load_meshes=False).robot


def _origin(matrix: np.ndarray | None) -> np.ndarray:
    return np.eye(4) if matrix is None else np.asarray(matrix, dtype=np.float64)


def _link(link: Any, urdf: Path, packages: Mapping[str, Path], as_drawn: bool) -> Link:
    shapes = tuple(
        CollisionShape(_shape(item.geometry, urdf, packages, as_drawn), _origin(item.origin))
        for item in link.collisions
    )
    return Link(link.name, shapes, _mass(link))


def _mass(link: Any) -> LinkMass | None:
    if link.inertial is None:
        return None
    mass, inertia = float(link.inertial.mass), np.asarray(link.inertial.inertia)
    if not mass > 0:
        raise InputError(f"mass of link {link.name!r} must be positive, got {mass:g} kg")
    origin = _origin(link.inertial.origin)
    turn = origin[:3, :3]
    return LinkMass(mass, origin[:3, 3], turn @ inertia @ turn.T)


def _shape(geometry: Any, urdf: Path, packages: Mapping[str, Path], as_drawn: bool) -> Shape:
    if geometry.box is not None:
        x, y, z = map(float, geometry.box.size)
        return BoxShape((x, y, z))
    if geometry.sphere is not None:
        return SphereShape(float(geometry.sphere.radius))
    if geometry.cylinder is not None:
        return CylinderShape(float(geometry.cylinder.radius), float(geometry.cylinder.length))
    scale = geometry.mesh.scale
    x, y, z = (1.0, 1.0, 1.0) if scale is None else map(float, scale)
    file = mesh_path(geometry.mesh.filename, urdf, packages)
    return MeshShape(file, (x, y, z), as_drawn=as_drawn)


def _joint(joint: Any) -> RobotJoint:
    kind = _KINDS[joint.type]
    axis = np.array([0.0, 0.0, 1.0])
    if kind is not JointKind.FIXED:
        axis = np.asarray(joint.axis, dtype=np.float64)
        length = float(np.linalg.norm(axis))
        if not length > 1e-9:
            raise InputError(f"axis of joint {joint.name!r} has no length: {joint.axis}")
        if kind is JointKind.PRISMATIC and abs(length - 1) > _UNIT_SLACK:
            raise InputError(
                f"axis of joint {joint.name!r} must have length 1 for its slide to be in metres, "
                f"got {length:g}"
            )
        axis = axis / length
    lower, upper, effort = -math.inf, math.inf, math.inf
    if joint.type in ("revolute", "prismatic"):
        # The ends that a file leaves out are 0.
        lower, upper = float(joint.limit.lower or 0.0), float(joint.limit.upper or 0.0)
        if lower > upper:
            raise InputError(
                f"limits of joint {joint.name!r} must be lower <= upper, got {lower:g} and "
                f"{upper:g}"
            )
    if joint.limit is not None and joint.limit.effort:
        effort = float(joint.limit.effort)
    elif joint.limit is not None and joint.limit.effort is not None:
        warnings.warn(
            f'effort="0" of joint {joint.name!r} is taken as no limit: a drive without force moves '
            "nothing; drive(robot, drives) limits it by max_effort",
            InputWarning,
            stacklevel=3,
        )
    mimic = joint.mimic and Mimic(
        joint.mimic.joint, float(joint.mimic.multiplier), float(joint.mimic.offset)
    )
    return RobotJoint(
        joint.name,
        kind,
        joint.parent,
        joint.child,
        _origin(joint.origin),
        axis,
        lower,
        upper,
        effort,
        mimic,
    )
