# SPDX-License-Identifier: Apache-2.0
"""What a URDF file has to say, and what of it is not supported: refused by name.

What is not used here - looks, transmissions, tags of other programs - is left out.
http://wiki.ros.org/urdf/XML
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from xml.etree.ElementTree import Element

from taccel_lab.errors import InputError, InputWarning
from taccel_lab.files.collada_file import SUFFIX
from taccel_lab.files.inner_path import inner_path, real_path
from taccel_lab.files.text_file import shown
from taccel_lab.files.triangle_file import SUFFIXES

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
