# SPDX-License-Identifier: Apache-2.0
"""Elements and attributes of MJCF that are understood; whatever stands in no table is refused.

``READ`` reaches newton. ``IDLE`` has no influence on the kinematics, masses, shapes, contacts and
limits of a robot here: it is looked at and left out. ``LEFT_OUT`` are elements without such
influence, with all that they hold: looks, sensors, drives, notes, where a simulation starts and how
it is solved. https://mujoco.readthedocs.io/en/stable/XMLreference.html
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Rule = Literal["finite", "at least 0", "above 0", "not 0", "of a length above 0", "0", "whole"]


@dataclass(frozen=True)
class Numbers:
    """Finite numbers that an attribute may hold."""

    least: int
    """Fewest of them."""
    most: int
    rule: Rule = "finite"
    """What each has to be; a length is that of all."""


Check = Numbers | tuple[str, ...] | None
"""Numbers, one of some words, or any text."""


def _one(rule: Rule = "finite") -> Numbers:
    return Numbers(1, 1, rule)


def _three(rule: Rule = "finite") -> Numbers:
    return Numbers(3, 3, rule)


_ANY = Numbers(0, 1 << 24)
_POLYNOMIAL = Numbers(1, 3, "at least 0")
_TURNED: Mapping[str, Check] = {
    "quat": Numbers(4, 4, "of a length above 0"),
    "axisangle": Numbers(4, 4, "of a length above 0"),
    "euler": _three(),
    "xyaxes": Numbers(6, 6, "of a length above 0"),
    "zaxis": _three("of a length above 0"),
}
ORIENTATIONS = tuple(_TURNED)
"""Attributes of which an element may have one."""
_POSE: Mapping[str, Check] = {"pos": _three(), **_TURNED}
_BOOL, _AUTO = ("true", "false"), ("true", "false", "auto")
_SOLVER: Mapping[str, Check] = dict.fromkeys(
    ("solimp", "solref", "solimplimit", "solreflimit", "solimpfriction", "solreffriction"),
    Numbers(1, 5),
)

READ: Mapping[str, Mapping[str, Check]] = {
    "mujoco": {"model": None},
    "compiler": {
        "angle": ("degree", "radian"),
        "autolimits": _BOOL,
        "balanceinertia": _BOOL,
        "boundinertia": _one("at least 0"),
        "boundmass": _one("at least 0"),
        "eulerseq": None,
        "fitaabb": _BOOL,
        "inertiafromgeom": _AUTO,
        "inertiagrouprange": Numbers(2, 2, "whole"),
    },
    "mesh": {
        "content_type": None,
        "face": _ANY,
        "file": None,
        "inertia": ("convex", "exact", "legacy", "shell"),
        "maxhullvert": _one("whole"),
        "name": None,
        "refpos": _three(),
        "refquat": Numbers(4, 4, "of a length above 0"),
        "scale": _three("not 0"),
        "vertex": _ANY,
    },
    "worldbody": {},
    "body": {"name": None, **_POSE},
    "frame": {"name": None, **_POSE},
    "inertial": {
        **_POSE,
        "diaginertia": _three("at least 0"),
        "fullinertia": Numbers(6, 6),
        "mass": _one("at least 0"),
    },
    "joint": {
        "actuatorfrclimited": _AUTO,
        "actuatorfrcrange": Numbers(2, 2),
        "axis": _three("of a length above 0"),
        "limited": _AUTO,
        "name": None,
        "pos": _three(),
        "range": Numbers(2, 2),
        "ref": _one(),
        "type": ("hinge", "slide", "ball", "free"),
    },
    "freejoint": {"name": None},
    "geom": {
        **_POSE,
        "conaffinity": _one("whole"),
        "contype": _one("whole"),
        "density": _one("at least 0"),
        "fitscale": _one("above 0"),
        "friction": Numbers(1, 3, "at least 0"),
        "fromto": Numbers(6, 6),
        "group": _one("whole"),
        "mass": _one("at least 0"),
        "mesh": None,
        "name": None,
        "size": Numbers(1, 3, "at least 0"),
        "type": ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh"),
    },
    "equality": {"active": _BOOL, "joint1": None, "joint2": None, "name": None,
                 "polycoef": Numbers(1, 5)},
    "pair": {"geom1": None, "geom2": None, "name": None},
}  # fmt: skip
"""Attributes that newton gets."""
IDLE: Mapping[str, Mapping[str, Check]] = {
    "compiler": {
        **dict.fromkeys(
            ("alignfree", "assetdir", "conflict", "discardvisual", "fusestatic", "meshdir",
             "savecanonical", "savecompiled", "saveinertial", "strippath", "texturedir",
             "usethread", "convexhull")
        ),
        # Of MuJoCo 2, and what MuJoCo alone would do.
        "coordinate": ("local",),
        "exactmeshinertia": ("false",),
        "settotalmass": ("-1",),
    },
    "mesh": {"material": None, "normal": _ANY, "smoothnormal": _BOOL, "texcoord": _ANY},
    "body": {
        "gravcomp": _one(), "mocap": ("false",), "sleep": None, "user": _ANY,
    },
    "joint": {
        **_SOLVER,
        "actuatorgravcomp": _BOOL,
        "armature": _one("at least 0"),
        "damping": _POLYNOMIAL,
        "frictionloss": _one("at least 0"),
        "group": _one("whole"),
        "margin": _one(),
        "springdamper": Numbers(2, 2, "at least 0"),
        "springref": _one(),
        "springyield": _ANY,
        "stiffness": _POLYNOMIAL,
        "user": _ANY,
    },
    "freejoint": {"align": _AUTO, "group": _one("whole")},
    "geom": {
        **_SOLVER,
        "adhesion": _one("0"),
        "castshadow": _BOOL,
        "condim": ("1", "3", "4", "6"),
        "fluidcoef": _ANY,
        "fluidshape": ("none", "ellipsoid"),
        "gap": _one(),
        "margin": _one(),
        "material": None,
        "priority": _one("whole"),
        "rgba": Numbers(4, 4),
        "shellinertia": ("false",),
        "solmix": _one("at least 0"),
        "surfacevel": Numbers(0, 6, "0"),
        "user": _ANY,
    },
    "equality": _SOLVER,
    "pair": {
        **_SOLVER,
        "adhesion": _one("0"),
        "condim": ("1", "3", "4", "6"),
        "friction": Numbers(1, 5, "at least 0"),
        "gap": _one(),
        "margin": _one(),
    },
    "tendon": {
        **_SOLVER,
        **dict.fromkeys(("armature", "frictionloss", "width"), _one("at least 0")),
        "actuatorfrclimited": _AUTO,
        "actuatorfrcrange": Numbers(2, 2),
        "damping": _POLYNOMIAL,
        "group": _one("whole"),
        "limited": _AUTO,
        "margin": _one(),
        "material": None,
        "name": None,
        "range": Numbers(2, 2),
        "rgba": Numbers(4, 4),
        "springlength": Numbers(1, 2),
        "springyield": _ANY,
        "stiffness": _POLYNOMIAL,
        "user": _ANY,
    },
    "flag": dict.fromkeys(("constraint", "contact", "equality", "limit"), ("enable",)),
}  # fmt: skip
"""Attributes that are looked at and left out."""
_SEEN = ("site", "camera", "light")
_IN_BODY = ("body", "frame", "geom")
_DRIVES = (
    "general", "motor", "position", "velocity", "intvelocity", "orientation", "pid", "damper",
    "cylinder", "muscle", "adhesion", "dcmotor",
)  # fmt: skip
PARTS: Mapping[str, tuple[str, ...]] = {
    "mujoco": ("asset", "compiler", "contact", "default", "deformable", "equality", "option",
               "tendon", "worldbody"),
    "option": ("flag",),
    "default": ("default", "equality", "geom", "joint", "mesh", "pair", "tendon"),
    "asset": ("mesh",),
    "worldbody": _IN_BODY,
    "body": (*_IN_BODY, "freejoint", "inertial", "joint"),
    "frame": _IN_BODY,
    "contact": ("pair",),
    "equality": ("joint",),
    "tendon": ("fixed", "spatial"),
}  # fmt: skip
"""Elements that are read, by the one that holds them."""
LEFT_OUT: Mapping[str, tuple[str, ...]] = {
    "mujoco": ("actuator", "custom", "extension", "keyframe", "sensor", "size", "statistic",
               "visual"),
    "compiler": ("lengthrange",),
    "default": (*_SEEN, *_DRIVES, "material", "texture"),
    "asset": ("hfield", "material", "skin", "texture"),
    "deformable": ("skin",),
    **dict.fromkeys(("worldbody", "body", "frame"), _SEEN),
    "contact": ("exclude",),
    **dict.fromkeys(("fixed", "spatial"), ("geom", "joint", "pulley", "site")),
}  # fmt: skip
"""Elements that are left out, by the one that holds them; a geom of a height field is refused."""
