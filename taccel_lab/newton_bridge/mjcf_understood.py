# SPDX-License-Identifier: Apache-2.0
"""An MJCF robot as newton gets it: what is understood of it, with nothing left to guess.

Defaults are put into the elements, as MuJoCo does, and a body of several joints becomes one for
each: newton takes the place of the first for all of them, and slides before turns. Elements,
attributes and values that are not understood are refused by name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from taccel_lab.errors import InputError, naming
from taccel_lab.files.declared import require_few
from taccel_lab.files.regular_file import shown
from taccel_lab.newton_bridge.mjcf_elements import (
    IDLE,
    LEFT_OUT,
    ORIENTATIONS,
    PARTS,
    READ,
    Numbers,
)

MAX_BODIES, MAX_GEOMS = 1000, 2000
"""Newton takes 4 ms for a body and 2 ms for a geom; a humanoid with hands has 100 of each."""
_LARGEST = 3e38
"""Largest number of FP32, in which newton computes."""
_SIZES = {
    "sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3, "plane": 3, "mesh": 0,
}  # fmt: skip
"""Count of sizes that a geom of a type has."""
_PREFIXED = ("friction", "size")
"""Attributes of which an element may give the first numbers; others stay those of its class."""


def understood(root: Element, files: Mapping[Element, Path], fixed: bool) -> Element:
    """The robot in elements that newton reads as MuJoCo does.

    Args:
        root: Root of the file, its includes in place.
        files: The included file of each element that stands first in one.
        fixed: Whether something takes the place of the joints of its first bodies.

    Raises InputError that names what is not understood, with its place.
    """
    return _Robot(files, fixed).whole(root)


class _Robot:
    """One robot that is gone through."""

    def __init__(self, files: Mapping[Element, Path], fixed: bool) -> None:
        self._files, self._fixed = files, fixed
        self._classes: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        self._names: set[tuple[str, str]] = set()
        self._meshes: set[str] = set()
        self._count = {"body": 0, "geom": 0}

    def whole(self, root: Element) -> Element:
        made = Element("mujoco", self._attributes(root, "the file", "mujoco", {}))
        sections = list(self._parts(root, "the file", "mujoco"))
        for section in sections:
            if section.tag == "default":
                self._default(section, None)
        # Bodies name meshes, and constraints name joints.
        for tag in ("compiler", "option", "asset", "worldbody", "equality", "contact", "tendon"):
            for section in sections:
                if section.tag == tag:
                    with self._of_its_file(section):
                        getattr(self, f"_{tag}")(section, made)
        for section in sections:
            if section.tag == "deformable":
                list(self._parts(section, "<deformable>", "deformable"))
        return made

    # What any element is ------------------------------------------------------------------------

    def _of_its_file(self, element: Element) -> AbstractContextManager[None]:
        return naming(self._files.get(element, ""))

    def _parts(self, element: Element, where: str, kind: str) -> Iterator[Element]:
        """Parts of an element that are read; InputError for what is not understood."""
        for child in element:
            if child.tag in PARTS.get(kind, ()):
                yield child
            elif child.tag not in LEFT_OUT.get(kind, ()):
                with self._of_its_file(child):
                    raise InputError(
                        f"<{child.tag}> in {where} is not understood: remove it, or save the model "
                        "as MuJoCo expands it (mj_saveLastXML)"
                    )

    def _attributes(
        self, element: Element, where: str, kind: str, defaults: Mapping[str, str]
    ) -> dict[str, str]:
        """Attributes of an element over those of its class, those that are read; the rest is looked
        at."""
        given = dict(defaults)
        for key, text in element.attrib.items():
            words = text.split()
            if key in _PREFIXED and key in given:
                words += given[key].split()[len(words) :]
                text = " ".join(words)
            given[key] = text
        read, idle = READ.get(kind, {}), IDLE.get(kind, {})
        what = f"<{element.tag}> {shown(given['name'])}" if "name" in given else f"<{element.tag}>"
        what = f"{what} in {where}"
        for key, text in given.items():
            if key not in read and key not in idle:
                raise InputError(f"{key} of {what} is not understood: remove it")
            _check(read[key] if key in read else idle[key], key, text, what)
        if sum(key in given for key in ORIENTATIONS) > 1:
            raise InputError(f"{what} states more than one of {', '.join(ORIENTATIONS)}")
        if (name := given.get("name")) and element.tag in ("body", "geom", "joint", "mesh"):
            # As newton writes it.
            own = element.tag, re.sub(r"\W", "_", name)
            if own in self._names:
                raise InputError(f"two elements <{element.tag}> are called {shown(name)}")
            self._names.add(own)
        return {key: text for key, text in given.items() if key in read}

    def _default(self, section: Element, above: str | None) -> None:
        name = section.get("class", "main" if above is None else "")
        if (above is None) != (name == "main") or not name:
            raise InputError(f"a class of defaults is called {shown(name)}: the first one is main")
        if above is not None and name in self._classes:
            raise InputError(f"two classes of defaults are called {shown(name)}")
        own = self._classes.setdefault(name, {})
        if above is not None:
            own |= {tag: dict(values) for tag, values in self._classes[above].items()}
        parts = list(self._parts(section, f"defaults {shown(name)}", "default"))
        for part in parts:
            if part.tag != "default":
                where = f"defaults {shown(name)}"
                self._attributes(part, where, part.tag, {})
                merged = own.setdefault(part.tag, {})
                for key, text in part.attrib.items():
                    kept = merged.get(key, "").split() if key in _PREFIXED else []
                    merged[key] = " ".join([*text.split(), *kept[len(text.split()) :]])
        for part in parts:
            if part.tag == "default":
                self._default(part, name)

    def _class(self, element: Element, around: str, kind: str) -> dict[str, str]:
        name = element.attrib.pop("class", around)
        if name not in self._classes:
            raise InputError(f"<{element.tag}> is of class {shown(name)}, which has no defaults")
        return self._classes[name].get(kind, {})

    def _around(self, element: Element, around: str) -> str:
        """The class of what is inside an element and says none."""
        name = element.attrib.pop("childclass", around)
        if name not in self._classes:
            raise InputError(f"childclass {shown(name)} of <{element.tag}> has no defaults")
        return name

    # Sections -----------------------------------------------------------------------------------

    def _compiler(self, section: Element, made: Element) -> None:
        found = self._attributes(section, "the file", "compiler", {})
        if not re.fullmatch("[xyzXYZ]{3}", found.get("eulerseq", "xyz")):
            raise InputError("eulerseq of <compiler> must be three of x, y, z, X, Y and Z")
        list(self._parts(section, "<compiler>", "compiler"))
        SubElement(made, "compiler", found)

    def _option(self, section: Element, made: Element) -> None:
        # How a simulation runs; a robot knows neither its gravity nor its solver.
        for flag in self._parts(section, "<option>", "option"):
            for key, words in IDLE["flag"].items():
                _check(words, key, flag.get(key, "enable"), "<flag>")

    def _asset(self, section: Element, made: Element) -> None:
        assets = SubElement(made, "asset")
        for mesh in self._parts(section, "<asset>", "asset"):
            found = self._attributes(mesh, "<asset>", "mesh", self._class(mesh, "main", "mesh"))
            list(self._parts(mesh, "<mesh>", "mesh"))
            file = found.get("file", "")
            if not file and "vertex" not in found:
                raise InputError(
                    f"<mesh> {shown(found.get('name', ''))} has neither file nor vertex"
                )
            kind = found.pop("content_type", None)
            if kind not in (None, _CONTENT.get(Path(file).suffix.lower())):
                raise InputError(
                    f"content_type of mesh {shown(Path(file).name)} contradicts its name"
                )
            self._meshes.add(found.setdefault("name", Path(file).stem))
            SubElement(assets, "mesh", found)

    def _worldbody(self, section: Element, made: Element) -> None:
        world = SubElement(
            made, "worldbody", self._attributes(section, "the file", "worldbody", {})
        )
        self._inside(section, world, "<worldbody>", "main")

    def _inside(self, element: Element, made: Element, where: str, around: str) -> None:
        """Read all that a body, the world or a frame holds."""
        kind = element.tag
        joints = [part for part in element if part.tag in ("joint", "freejoint")]
        for part in self._parts(element, where, kind):
            with self._of_its_file(part):
                if part.tag == "body":
                    self._body(part, made, where, around)
                elif part.tag == "frame":
                    inner = self._around(part, around)
                    found = self._attributes(part, where, "frame", {})
                    self._inside(part, SubElement(made, "frame", found), where, inner)
                elif part.tag == "geom":
                    self._geom(part, made, where, around)
                elif part.tag == "inertial":
                    self._inertial(part, made, where, bool(joints))

    def _body(self, body: Element, made: Element, where: str, around: str) -> None:
        around = self._around(body, around)
        pose = self._attributes(body, where, "body", {})
        number = self._count["body"]
        name = pose.setdefault("name", f"body_{number}")
        where = f"body {shown(name)}"
        joints = [self._joint(part, where, around) for part in body if part.tag in _JOINTS]
        free = [joint for joint in joints if joint.get("type") == "free"]
        if free and len(joints) > 1:
            raise InputError(f"{where} has a free joint and another one")
        if joints and not free and self._fixed and made.tag == "worldbody":
            raise InputError(
                f"floating and base_joint take the place of joints of the first bodies, such as "
                f"{where}: leave them out"
            )
        for k, joint in enumerate(joints):
            joint.attrib.setdefault("name", f"{name}_joint_{k}")
            self._counted("body", "bodies", MAX_BODIES)
            last = k == len(joints) - 1
            label = name if last else f"{name}_before_{joints[k + 1].get('name')}"
            made = SubElement(made, "body", {**(pose if k == 0 else {}), "name": label})
            made.append(joint)
        if not joints:
            self._counted("body", "bodies", MAX_BODIES)
            made = SubElement(made, "body", pose)
        self._inside(body, made, where, around)

    def _counted(self, tag: str, what: str, limit: int) -> None:
        self._count[tag] += 1
        require_few("the robot", what, self._count[tag], limit)

    def _joint(self, joint: Element, where: str, around: str) -> Element:
        with self._of_its_file(joint):
            if joint.tag == "freejoint":
                found = self._attributes(joint, where, "freejoint", {})
                return Element("joint", {**found, "type": "free"})
            found = self._attributes(joint, where, "joint", self._class(joint, around, "joint"))
            what = f"<joint> {shown(found.get('name', ''))} in {where}"
            _check_range(found, "range", "limited", what)
            _check_range(found, "actuatorfrcrange", "actuatorfrclimited", what)
            return Element("joint", found)

    def _inertial(self, inertial: Element, made: Element, where: str, moves: bool) -> None:
        found = self._attributes(inertial, where, "inertial", {})
        if made.find("inertial") is not None:
            raise InputError(f"{where} has two elements <inertial>")
        if "mass" not in found or (moves and not float(found["mass"]) > 0):
            raise InputError(f"mass of <inertial> in {where} must be above 0")
        SubElement(made, "inertial", found)

    def _geom(self, geom: Element, made: Element, where: str, around: str) -> None:
        self._counted("geom", "geoms", MAX_GEOMS)
        found = self._attributes(geom, where, "geom", self._class(geom, around, "geom"))
        list(self._parts(geom, "<geom>", "geom"))
        kind = found.get("type", "sphere")
        what = f"<geom> {shown(found.get('name', ''))} in {where}"
        mesh = found.get("mesh")
        if (mesh is not None and mesh not in self._meshes) or (mesh is None and kind == "mesh"):
            raise InputError(f"{what} is of mesh {shown(mesh or '')}, which is not there")
        if "fromto" in found:
            ends = [float(word) for word in found["fromto"].split()]
            if kind not in ("capsule", "cylinder") or ends[:3] == ends[3:]:
                raise InputError(f"fromto of {what} is understood of a capsule or cylinder of some "
                                 "length: give pos, orientation and size")  # fmt: skip
        if mesh is None:
            needed = 1 if "fromto" in found else _SIZES[kind]
            sizes = [float(word) for word in found.get("size", "").split()][:needed]
            if kind != "plane" and (len(sizes) < needed or not all(sizes)):
                raise InputError(f"size of {what} must be {needed} numbers above 0")
        SubElement(made, "geom", found)

    def _equality(self, section: Element, made: Element) -> None:
        equality = SubElement(made, "equality")
        for part in list(section):
            # One that is not active binds nothing.
            if part.get("active") == "false":
                section.remove(part)
        for part in self._parts(section, "<equality>, which binds bodies,", "equality"):
            defaults = self._class(part, "main", "equality")
            found = self._attributes(part, "<equality>", "equality", defaults)
            what = f"<joint> {shown(found.get('name', ''))} in <equality>"
            for key in ("joint1", "joint2"):
                if ("joint", re.sub(r"\W", "_", found.get(key, ""))) not in self._names:
                    raise InputError(f"{key} of {what} must be the name of a joint")
            if any(float(word) for word in found.get("polycoef", "").split()[2:]):
                raise InputError(f"polycoef of {what} must be linear, its other numbers 0")
            SubElement(equality, "joint", found)

    def _contact(self, section: Element, made: Element) -> None:
        contact = SubElement(made, "contact")
        for pair in self._parts(section, "<contact>", "contact"):
            defaults = self._class(pair, "main", "pair")
            SubElement(contact, "pair", self._attributes(pair, "<contact>", "pair", defaults))

    def _tendon(self, section: Element, made: Element) -> None:
        """Springs and drives that pull by tendons are left out as those of joints are; limits and
        masses would be missed."""
        for tendon in self._parts(section, "<tendon>", "tendon"):
            defaults = self._class(tendon, "main", "tendon")
            given = defaults | tendon.attrib
            self._attributes(tendon, "<tendon>", "tendon", defaults)
            list(self._parts(tendon, f"<{tendon.tag}>", tendon.tag))
            if _is_limited(given, "range", "limited"):
                raise InputError(
                    f"range of tendon {shown(given.get('name', ''))} is not understood: limits of "
                    "joints are, those of tendons are not"
                )


_JOINTS = ("joint", "freejoint")
_CONTENT = {".stl": "model/stl", ".obj": "model/obj", ".msh": "model/vnd.mujoco.msh"}


def _check(check: object, key: str, text: str, what: str) -> None:
    """Refuse a value of an attribute that is not as ``check`` has it."""
    wanted = ""
    if isinstance(check, Numbers):
        wanted = _wanted(check, text)
    elif isinstance(check, tuple) and text not in check:
        wanted = " or ".join(check)
    if wanted:
        raise InputError(f"{key} of {what} must be {wanted}, got {shown(text)}")


def _wanted(check: Numbers, text: str) -> str:
    """Words for a rule that numbers break; empty where they keep it."""
    words = text.split()
    if not check.least <= len(words) <= check.most:
        few = f"{check.least}" if check.least == check.most else f"{check.least} to {check.most}"
        return f"{few} numbers"
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [math.nan]
    if not all(abs(value) < _LARGEST for value in values):
        return "finite numbers"
    rule = check.rule
    wrong = (
        (rule == "at least 0" and min(values, default=0) < 0)
        or (rule == "above 0" and min(values) <= 0)
        or (rule == "not 0" and not all(values))
        or (rule == "of a length above 0" and not any(values))
        or (rule == "0" and any(values))
        or (rule == "whole" and not all(re.fullmatch(r"[+-]?\d{1,9}", word) for word in words))
    )
    return {"whole": "whole numbers"}.get(rule, rule) if wrong else ""


def _is_limited(found: Mapping[str, str], key: str, switch: str) -> bool:
    stated = found.get(switch, "auto")
    return stated == "true" or (
        stated == "auto" and any(float(word) for word in found.get(key, "").split())
    )


def _check_range(found: Mapping[str, str], key: str, switch: str, what: str) -> None:
    if not _is_limited(found, key, switch):
        return
    ends = [float(word) for word in found.get(key, "").split()]
    if len(ends) != 2 or not ends[0] < ends[1]:
        raise InputError(
            f"{key} of {what} must be two numbers, the first below the second, got "
            f"{shown(found.get(key, ''))}"
        )
