# SPDX-License-Identifier: Apache-2.0
"""A robot from a URDF file, read by yourdfpy (the extra ``robots``).

What a file has to say is checked, and what of it is not supported refused by name. What is not used
here - looks, transmissions, tags of other programs - is left out. http://wiki.ros.org/urdf/XML
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError, InputWarning, naming
from taccel_lab.files.collada_file import SUFFIX
from taccel_lab.files.inner_path import inner_path, real_path
from taccel_lab.files.regular_file import shown
from taccel_lab.files.triangle_file import SUFFIXES
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

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
_OTHER_TYPES = ("planar", "floating")
_SHAPES = ("box", "sphere", "cylinder", "mesh")
_PARTS: Mapping[str, tuple[str, ...]] = {
    "robot": ("link", "joint"),
    "link": ("inertial", "collision"),
    "inertial": ("origin", "mass", "inertia"),
    "collision": ("origin", "geometry"),
    "geometry": _SHAPES,
    "joint": ("parent", "child", "origin", "axis", "limit", "mimic"),
}
"""Elements that are read, by the one that holds them."""
_NUMBERS: Mapping[str, Mapping[str, int]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
    "limit": {"lower": 1, "upper": 1, "effort": 1, "velocity": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
}
"""Attributes that are numbers, and how many."""
_NEEDED: Mapping[str, tuple[str, ...]] = {
    "robot": ("name",),
    "link": ("name",),
    "joint": ("name", "type"),
    "parent": ("link",),
    "child": ("link",),
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "mesh": ("filename",),
    "mimic": ("joint",),
    "mass": ("value",),
    "inertia": ("ixx", "iyy", "izz"),
}
"""Attributes that have to be there."""
_NEEDED_PARTS: Mapping[str, tuple[str, ...]] = {
    "joint": ("parent", "child"),
    "collision": ("geometry",),
    "inertial": ("mass", "inertia"),
}


def checked_urdf(root: Element, shapes: bool = True) -> Element:
    """The robot of a URDF file's root, with the elements that are used alone.

    ``shapes``: whether collision shapes are.

    Raises InputError: what is missing, no number, of an unknown kind or not supported.
    """
    if root.tag != "robot":
        raise InputError(f"its root element is <{root.tag}>; a URDF file's is <robot>")
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise InputError(
            "it holds xacro macros, which are not expanded here: make a URDF of it first, "
            "xacro robot.urdf.xacro > robot.urdf"
        )
    return _checked(root, "the robot", () if shapes else ("collision",))


def _checked(element: Element, what: str, left_out: tuple[str, ...]) -> Element:
    tag = str(element.tag)
    for name in _NEEDED.get(tag, ()):
        if not (element.get(name) or "").strip():
            raise InputError(f"<{tag}> of {what} has no {name!r}")
    if tag in ("link", "joint"):
        what = f"{tag} {element.get('name')!r}"
    for name, count in _NUMBERS.get(tag, {}).items():
        if (text := element.get(name)) is not None:
            _check_numbers(text, count, f"{name} of <{tag}> of {what}")
    _check_kind(element, what)
    kept = Element(tag, dict(element.attrib))
    for child in element:
        if child.tag in _PARTS.get(tag, ()) and child.tag not in left_out:
            if child.tag == "inertial" and child.find("mass") is None:
                warnings.warn(
                    f"<inertial> of {what} has no <mass> and is left out: where drives move the "
                    "link, mass and inertia are estimated from its collision shapes",
                    InputWarning,
                    stacklevel=2,
                )
                continue
            part = _checked(child, what, left_out)
            if part.tag != "inertial" or _says_something(part):
                kept.append(part)
    for name in _NEEDED_PARTS.get(tag, ()):
        if kept.find(name) is None:
            raise InputError(f"<{tag}> of {what} has no <{name}>")
    return kept


def _says_something(inertial: Element) -> bool:
    """Whether a link has mass: frames state 0 kg."""
    mass = inertial.find("mass")
    return mass is not None and float(str(mass.get("value"))) != 0


def _check_kind(element: Element, what: str) -> None:
    if element.tag == "geometry":
        kinds = [str(child.tag) for child in element]
        if len(kinds) != 1 or kinds[0] not in _SHAPES:
            raise InputError(
                f"collision shape of {what} is {shown(', '.join(kinds) or 'nothing')}; it must be "
                f"one of {', '.join(_SHAPES)}"
            )
    if element.tag == "mesh":
        name = str(element.get("filename"))
        if not name.lower().endswith((*SUFFIXES, SUFFIX)):
            raise InputError(
                f"collision mesh {shown(Path(name).name)} of {what} is of a kind that is not "
                f"read; allowed are {', '.join((*SUFFIXES, SUFFIX))}"
            )
    if element.tag != "joint":
        return
    kind = str(element.get("type"))
    if kind in _OTHER_TYPES:
        raise InputError(
            f"{what} is {kind}, which is not supported: joints may be {', '.join(JOINT_TYPES)}"
        )
    if kind not in JOINT_TYPES:
        raise InputError(
            f"{what} is of type {shown(kind)}, which URDF does not know; allowed are "
            f"{', '.join(JOINT_TYPES)}"
        )
    if kind in ("revolute", "prismatic") and element.find("limit") is None:
        raise InputError(
            f"{what} is {kind} and has no <limit>; give it one"
            + (", or make it continuous" if kind == "revolute" else "")
        )


def _check_numbers(text: str, count: int, what: str) -> None:
    wanted = "a finite number" if count == 1 else f"{count} finite numbers"
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InputError(f"{what} must be {wanted}, got {shown(text)}")


def mesh_path(name: str, urdf: Path, packages: Mapping[str, Path] = MappingProxyType({})) -> Path:
    """The file that a mesh's name stands for.

    ``package://a/b`` is looked for in the folder that ``packages`` names for ``a``, or else as
    folder ``a`` beside or above the URDF file, and as a folder of that name that it lies in; it
    stays in that folder. Other names count from the file's own folder; where the file is a link,
    from that of what it leads to, too. They may lead out of it, as ``../meshes`` does in most
    packages: what is read there is triangles or refused.

    Raises InputError where there is no such file, and for a link that leads out of the folder.
    """
    folder, hint = real_path(urdf).parent, ""
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        if package in packages:
            places = [packages[package]]
        else:
            hint = (
                f"; say where the package is: load_urdf(..., packages={{{package!r}: FOLDER}}), or "
                f"--package {package} FOLDER"
            )
            places = _beside(folder, package)
        found = [inner_path(place, rest) for place in places if place.is_dir()]
        looked = places[0] / rest
    else:
        rest = name.removeprefix("file://")
        outward = PurePosixPath(rest).is_absolute() or ".." in PurePosixPath(rest).parts
        places = dict.fromkeys((folder, urdf.parent))
        found = [place / rest if outward else inner_path(place, rest) for place in places]
        looked = found[0]
    for path in found:
        if path.is_file():
            return path
    raise InputError(f"mesh file {shown(name)} is not there; looked in {shown(str(looked))}{hint}")


def _beside(folder: Path, package: str) -> list[Path]:
    return [
        place if place.name == package else place / package for place in (folder, *folder.parents)
    ]


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
