# SPDX-License-Identifier: Apache-2.0
"""Which faces of an imported body are contact, bond and window, in words.

A selector is ``kind:value``; several are joined:

- ``name:contact`` faces of that name in the file, ``*`` and ``?`` as in file names;
- ``color:e68c33`` faces of that colour (sRGB, hexadecimal);
- ``plane:-z`` the plane faces farthest out in a direction that face that way;
- ``normal:+z`` faces whose normal at the middle is within 60 degrees of a direction,
  ``normal:+z@45`` within 45;
- ``index:3,5-8`` faces by their number in the listing;
- ``rect:18x14`` for the window only: a rectangle in the middle of the glued plane [mm], which is
  split off.

Directions are those of the file: ``+x`` ... ``-z``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import fnmatchcase

import numpy as np

from taccel_lab.cad.gel_import.importer import FaceInfo, listing
from taccel_lab.errors import InputError

KINDS = ("name", "color", "plane", "normal", "index", "rect")
DEFAULT_ANGLE_DEG = 60.0
_SAME_PLANE_MM = 1e-3
_SAME_NORMAL = 1 - 1e-6


def direction(words: str) -> np.ndarray:
    """Unit vector of "+x", "-z" and so on."""
    match = re.fullmatch(r"([+-]?)([xyz])", words.strip())
    if not match:
        raise InputError(f"{words!r} is not a direction; use +x, -x, +y, -y, +z or -z")
    return np.eye(3)["xyz".index(match[2])] * (-1.0 if match[1] == "-" else 1.0)


def rectangle_of(selectors: Sequence[str]) -> tuple[float, float] | None:
    """The size given as ``rect:XxY`` [mm], or None."""
    for selector in selectors:
        kind, _, value = selector.partition(":")
        if kind.strip() != "rect":
            continue
        match = re.fullmatch(r"\s*([0-9.]+)\s*[x×]\s*([0-9.]+)\s*", value)
        if not match or len(selectors) > 1:
            raise InputError(f"{selector!r} must stand alone and read rect:18x14, sizes in mm")
        return float(match[1]), float(match[2])
    return None


def select_faces(selectors: Sequence[str], table: Sequence[FaceInfo], what: str) -> set[int]:
    """Numbers of the faces that any of the selectors chooses.

    Raises InputError, with the list of faces, when a selector is malformed or chooses none.
    """
    chosen: set[int] = set()
    for selector in selectors:
        kind, colon, value = selector.partition(":")
        kind = kind.strip()
        if not colon or kind not in KINDS or not value.strip():
            raise InputError(
                f"{what}: {selector!r} selects no faces; write one of name:NAME, color:RRGGBB, "
                "plane:-z, normal:+z, normal:+z@45, index:3,5-8, rect:18x14 (window only)"
            )
        if kind == "rect":
            raise InputError(f"{what}: {selector!r} is allowed for the window only")
        found = _SELECT[kind](value.strip(), table)
        if not found:
            raise InputError(
                f"{what}: {selector!r} matches none of the {len(table)} faces of this body"
                f"{_names_there(kind, table)}\n{listing(table)}"
            )
        chosen |= found
    return chosen


def _names_there(kind: str, table: Sequence[FaceInfo]) -> str:
    if kind not in ("name", "color"):
        return ""
    there = sorted({getattr(info, kind) for info in table} - {""})
    words = ", ".join(there) if there else "none at all"
    other = "" if there else "; select by plane:, normal: or index: instead"
    return f" ({kind}s in the file: {words}{other})"


def _by_name(value: str, table: Sequence[FaceInfo]) -> set[int]:
    return {info.index for info in table if info.name and fnmatchcase(info.name, value)}


def _by_color(value: str, table: Sequence[FaceInfo]) -> set[int]:
    return {info.index for info in table if info.color == value.lstrip("#").lower()}


def _by_plane(value: str, table: Sequence[FaceInfo]) -> set[int]:
    axis = direction(value)
    flat = [
        info for info in table if info.kind == "plane" and np.dot(info.normal, axis) > _SAME_NORMAL
    ]
    if not flat:
        return set()
    farthest = max(float(np.dot(info.center_mm, axis)) for info in flat)
    return {i.index for i in flat if np.dot(i.center_mm, axis) > farthest - _SAME_PLANE_MM}


def _by_normal(value: str, table: Sequence[FaceInfo]) -> set[int]:
    words, at, limit = value.partition("@")
    try:
        angle = float(limit) if at else DEFAULT_ANGLE_DEG
    except ValueError as error:
        raise InputError(f"normal:{value} needs degrees after @, such as normal:+z@45") from error
    axis = direction(words)
    cosine = np.cos(np.radians(angle))
    return {info.index for info in table if np.dot(info.normal, axis) >= cosine - 1e-9}


def _by_index(value: str, table: Sequence[FaceInfo]) -> set[int]:
    chosen: set[int] = set()
    for item in value.split(","):
        match = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", item)
        if not match:
            raise InputError(f"index:{value} must be whole numbers such as index:3,5-8")
        first, last = int(match[1]), int(match[2] or match[1])
        if last < first or last >= len(table):
            raise InputError(
                f"index:{value}: the faces are numbered 0 to {len(table) - 1}\n{listing(table)}"
            )
        chosen |= set(range(first, last + 1))
    return chosen


_SELECT = {
    "name": _by_name,
    "color": _by_color,
    "plane": _by_plane,
    "normal": _by_normal,
    "index": _by_index,
}
