# SPDX-License-Identifier: Apache-2.0
"""A robot from a URDF file.

What a file has to say is checked, and what of it is not supported refused by name. What is not used
here - looks, transmissions, tags of other programs - is left out. http://wiki.ros.org/urdf/XML
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from types import MappingProxyType
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
from taccel_lab.robots.shapes import CollisionShape, MeshShape, PrimitiveShape, Shape

_KINDS = {
    "revolute": JointKind.REVOLUTE,
    "continuous": JointKind.REVOLUTE,
    "prismatic": JointKind.PRISMATIC,
    "fixed": JointKind.FIXED,
}
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
_LEFT_OUT: Mapping[str, tuple[str, ...]] = {
    "robot": ("gazebo", "gripper", "material", "mujoco", "ros2_control", "sensor", "transmission"),
    "link": ("audio_source", "collision_checking", "contact", "gazebo", "gravity", "kinematic",
             "material", "origin", "self_collision_checking", "self_filter", "sensor", "surface",
             "verbose", "visual"),
    "collision": ("contact_coefficients", "material", "verbose"),
    "joint": ("calibration", "dynamics", "gazebo", "hardwareInterface", "safety_controller"),
}  # fmt: skip
"""Elements without influence on kinematics, masses, shapes and limits; names with a colon are those
of other programs, too."""
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
    "dynamics": {"damping": 1, "friction": 1},
}
"""Attributes that are numbers, and how many."""
_AT_LEAST_0 = ("damping", "effort", "friction", "velocity")
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


def check_urdf(root: Element, shapes: bool = True) -> None:
    """Refuse a URDF file of which something that is used is missing, no number, of an unknown kind
    or not supported; ``shapes``: whether collision shapes are used."""
    if root.tag != "robot":
        raise InputError(f"its root element is <{root.tag}>; a URDF file's is <robot>")
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise InputError(
            "it holds xacro macros, which are not expanded here: make a URDF of it first, "
            "xacro robot.urdf.xacro > robot.urdf"
        )
    _check(root, "the robot", () if shapes else ("collision",))


def _check(element: Element, what: str, left_out: tuple[str, ...]) -> None:
    tag = str(element.tag)
    for name in _NEEDED.get(tag, ()):
        if not (element.get(name) or "").strip():
            raise InputError(f"<{tag}> of {what} has no {name!r}")
    if tag in ("link", "joint"):
        what = f"{tag} {element.get('name')!r}"
    for name, count in _NUMBERS.get(tag, {}).items():
        if (text := element.get(name)) is not None:
            _check_numbers(text, count, f"{name} of <{tag}> of {what}", name in _AT_LEAST_0)
    _check_kind(element, what)
    for child in element:
        known = (*_PARTS.get(tag, ()), *_LEFT_OUT.get(tag, ()))
        if child.tag not in known and not re.search("[:}]", str(child.tag)):
            raise InputError(f"<{child.tag}> of {what} is not understood: remove it")
        used = child.tag in (*_PARTS.get(tag, ()), "dynamics") and child.tag not in left_out
        # One without mass is left out, see ``_mass``.
        if used and (child.tag != "inertial" or child.find("mass") is not None):
            _check(child, what, left_out)
    for name in _NEEDED_PARTS.get(tag, ()):
        if element.find(name) is None:
            raise InputError(f"<{tag}> of {what} has no <{name}>")


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
            f"{what} is {kind}, which is not supported: joints may be {', '.join(_KINDS)}"
        )
    if kind not in _KINDS:
        raise InputError(
            f"{what} is of type {shown(kind)}, which URDF does not know; allowed are "
            f"{', '.join(_KINDS)}"
        )
    if kind in ("revolute", "prismatic") and element.find("limit") is None:
        raise InputError(
            f"{what} is {kind} and has no <limit>; give it one"
            + (", or make it continuous" if kind == "revolute" else "")
        )


def _check_numbers(text: str, count: int, what: str, positive: bool) -> None:
    wanted = "a finite number" if count == 1 else f"{count} finite numbers"
    wanted += " of at least 0" if positive else ""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    low = min(values, default=0.0) < 0 and positive
    if low or len(values) != count or not all(math.isfinite(value) for value in values):
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

    Looks, transmissions and elements of other programs are left out, others refused by name.

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
            meshes that are not there or not STL, PLY, OBJ or Collada.
    """
    path = Path(path)
    folders = {name: Path(folder) for name, folder in (packages or {}).items()}
    root = read_xml(path, "a URDF file")
    with naming(path):
        check_urdf(root, shapes)
        links = []
        for link in root.findall("link"):
            found = link.findall("collision") if shapes else []
            items = [(_shape(item, path, folders, as_drawn), _origin(item)) for item in found]
            collisions = tuple(CollisionShape(*item) for item in items)
            links.append(Link(str(link.get("name")), collisions, _mass(link)))
        joints = tuple(_joint(joint) for joint in root.findall("joint"))
        return Robot(str(root.get("name")), tuple(links), joints)


def _attribute(element: Element, part: str, name: str) -> str:
    """An attribute of a part that ``check_urdf`` has seen."""
    found = element.find(part)
    assert found is not None
    return str(found.get(name))


def _numbers(element: Element | None, name: str, default: str) -> np.ndarray:
    """The numbers of an attribute, ``default`` where it or its element is left out."""
    text = default if element is None else element.get(name, default)
    return np.array(text.split(), dtype=np.float64)


def _number(element: Element | None, name: str, default: float) -> float:
    return float(_numbers(element, name, str(default))[0])


def _origin(element: Element) -> np.ndarray:
    """Pose that an element's origin states [4, 4]: turned about fixed x, then y, then z; moved."""
    origin = element.find("origin")
    roll, pitch, yaw = _numbers(origin, "rpy", "0 0 0").tolist()
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    pose = np.eye(4)
    pose[:3, :3] = [
        [cp * cy, sp * (sr * cy) - cr * sy, sp * (cr * cy) + sr * sy],
        [cp * sy, sp * (sr * sy) + cr * cy, sp * (cr * sy) - sr * cy],
        [-sp, cp * sr, cp * cr],
    ]
    pose[:3, 3] = _numbers(origin, "xyz", "0 0 0")
    return pose


def _mass(link: Element) -> LinkMass | None:
    inertial = link.find("inertial")
    if inertial is None:
        return None
    if inertial.find("mass") is None:
        warnings.warn(
            f"<inertial> of link {link.get('name')!r} has no <mass> and is left out: where drives "
            "move the link, mass and inertia are estimated from its collision shapes",
            InputWarning,
            stacklevel=3,
        )
        return None
    mass, of = _number(inertial.find("mass"), "value", 0.0), inertial.find("inertia")
    if not mass:  # Frames state 0 kg.
        return None
    if not mass > 0:
        raise InputError(f"mass of link {link.get('name')!r} must be positive, got {mass:g} kg")
    inertia = np.array(
        [[_number(of, f"i{min(a, b)}{max(a, b)}", 0.0) for b in "xyz"] for a in "xyz"]
    )
    origin = _origin(inertial)
    turn = origin[:3, :3]
    return LinkMass(mass, origin[:3, 3], turn @ inertia @ turn.T)


def _shape(item: Element, urdf: Path, packages: Mapping[str, Path], as_drawn: bool) -> Shape:
    (shape,) = item.findall("geometry/*")
    if shape.tag == "box":
        x, y, z = _numbers(shape, "size", "").tolist()
        return PrimitiveShape.box((x, y, z))
    if shape.tag == "sphere":
        return PrimitiveShape.sphere(_number(shape, "radius", 0.0))
    if shape.tag == "cylinder":
        radius, length = _number(shape, "radius", 0.0), _number(shape, "length", 0.0)
        return PrimitiveShape.cylinder(radius, length)
    x, y, z = _numbers(shape, "scale", "1 1 1").tolist()
    file = mesh_path(str(shape.get("filename")), urdf, packages)
    return MeshShape(file, (x, y, z), as_drawn=as_drawn)


def _joint(joint: Element) -> RobotJoint:
    name, stated = str(joint.get("name")), str(joint.get("type"))
    kind, limit = _KINDS[stated], joint.find("limit")
    axis = np.array([0.0, 0.0, 1.0])
    if kind is not JointKind.FIXED:
        axis = _numbers(joint.find("axis"), "xyz", "1 0 0")
        length = float(np.linalg.norm(axis))
        if not length > 1e-9:
            raise InputError(f"axis of joint {name!r} has no length: {axis}")
        if kind is JointKind.PRISMATIC and abs(length - 1) > _UNIT_SLACK:
            raise InputError(
                f"axis of joint {name!r} must have length 1 for its slide to be in metres, "
                f"got {length:g}"
            )
        axis = axis / length
    lower, upper = -math.inf, math.inf
    if stated in ("revolute", "prismatic"):
        # The ends that a file leaves out are 0.
        lower, upper = _number(limit, "lower", 0.0), _number(limit, "upper", 0.0)
        if lower > upper:
            raise InputError(
                f"limits of joint {name!r} must be lower <= upper, got {lower:g} and {upper:g}"
            )
    effort = _number(limit, "effort", math.inf)
    if not effort:
        effort = math.inf
        warnings.warn(
            f'effort="0" of joint {name!r} is taken as no limit: a drive without force moves '
            "nothing; drive(robot, drives) limits it by max_effort",
            InputWarning,
            stacklevel=3,
        )
    mimic, followed = None, joint.find("mimic")
    if followed is not None:
        factor, offset = _number(followed, "multiplier", 1.0), _number(followed, "offset", 0.0)
        mimic = Mimic(str(followed.get("joint")), factor, offset)
    parent, child = (_attribute(joint, end, "link") for end in ("parent", "child"))
    return RobotJoint(name, kind, parent, child, _origin(joint), axis, lower, upper, effort, mimic)
