# SPDX-License-Identifier: Apache-2.0
"""Indenters by name, such as ``sphere:2.0`` or ``edge:90x6x0.1``; lengths in mm, angles in deg.

A mesh keeps its file's origin and axes: the origin is what a press puts at its place, the axes are
those of the gel frame, and the side of -z goes first. Its height in the file does not matter, as
depth counts from first touch. ``@+z`` and the like name another axis of the file that points into
the gel (``_INTO_GEL``).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taccel_lab.bodies.mesh_checks import check_edges, check_surface
from taccel_lab.bodies.surface_parts import turned_outward
from taccel_lab.errors import InputError, naming
from taccel_lab.files.triangle_file import read_triangle_file
from taccel_lab.geometry.connectivity import piece_of_cells
from taccel_lab.geometry.length_units import other_readings
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.presses.prisms import edge_mesh, grating_mesh, pair_mesh, roller_mesh
from taccel_lab.scene import Ball, TriangleMesh, box_mesh, cylinder_mesh
from taccel_lab.signals.texture import Texture

ALLOWED = (
    "sphere:RADIUS, cylinder:RADIUS (flat end), box:XxY (flat end), roller:RADIUSxLENGTH (lies "
    "along y), edge:ANGLExLENGTH[xRADIUS] (wedge along y, opening angle in degrees), "
    "grating:PITCHxRIDGESxLENGTH (ridges along y, half a pitch wide), pair:RADIUSxGAP (two round "
    "pins along x) or mesh:FILE[@AXIS] (STL, PLY or OBJ, placed by its own origin and axes; AXIS, "
    "of +x -x +y -y +z -z, points into the gel, -z when left out); lengths in mm"
)
_HEIGHT_M = 4e-3
_SIZE_LIMITS_MM = (0.05, 100.0)
_LEAST_PART_MM = 0.1
"""Least size of a mesh: the narrowest contact that elements are made for."""
_LARGEST_PART_MM = 1e3
"""Largest size of a mesh that is no file's."""
_MIN_THICKNESS_MM = 1e-3
"""Of a mesh: volume over half of its surface; coordinates of single precision hold 1e-5 mm."""
_ANGLE_LIMITS_DEG = (10.0, 170.0)
_RIDGE_LIMITS = (2, 100)
_INTO_GEL = {
    "-z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "+z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "+x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "-x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "+y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "-y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
}
"""Rotations, gel from file, that turn an axis to -z: about x, about y for an x axis."""


@dataclass(frozen=True)
class Indenter:
    """A rigid body in its own frame, whose origin is placed and whose -z side goes first; all
    but meshes from files are centred on it."""

    name: str
    """As given on the command line."""
    shape: Ball | TriangleMesh
    texture: Texture | None = None
    """What stands out of the shape, whose surface is its mean; depths count from first touch of its
    highest points. Images show it, the solver presses the shape."""
    remarks: tuple[str, ...] = ()
    """What was changed to read it, a sentence each."""

    def contact(self, depth_mm: float) -> float | ToolSection:
        """About what of a gel a press touches, by the shape's section at half of the depth: a
        ball's radius there [mm], which is Hertz's, else the section itself."""
        self.require_size(depth_mm)
        if not isinstance(self.shape, Ball):
            with naming(self.name):
                return ToolSection.of(self.shape.vertices_m, self.shape.faces, depth_mm)
        half, radius = 0.5 * depth_mm * 1e-3, self.shape.radius_m
        return 1e3 * (math.sqrt(half * (2 * radius - half)) if half < radius else radius)

    def require_size(self, depth_mm: float = 0.0, element_mm: float = 0.0) -> None:
        """Refuse a mesh that a press cannot mean, as its numbers are in another unit: InputError
        where it is smaller than ``depth_mm`` or than an element of the gel, ``element_mm``."""
        if isinstance(self.shape, Ball):
            return
        size_mm = 1e3 * float(np.ptp(self.shape.vertices_m, axis=0).max())
        why = ""
        if size_mm < _LEAST_PART_MM:
            why = f"at least {_LEAST_PART_MM:g} mm are needed for elements to see it"
        elif size_mm > _LARGEST_PART_MM:
            why = f"at most {_LARGEST_PART_MM:g} mm are allowed"
        elif size_mm < depth_mm:
            why = f"less than the press is deep, {depth_mm:.4g} mm"
        elif size_mm < element_mm:
            why = f"less than an element of the gel's mesh is long there, {element_mm:.3g} mm"
        if why:
            raise InputError(
                f"indenter {self.name} is {size_mm:.4g} mm across: {why}; "
                f"{other_readings(size_mm, 'millimetres')}. Scale it"
            )


def parse_indenter(text: str, texture: Texture | None = None) -> Indenter:
    """Read an indenter description; raises InputError that lists what is allowed. ``texture``: laid
    over its surface."""
    kind, _, value = text.partition(":")
    if kind == "mesh":
        shape, remarks = _read_mesh(value)
        return Indenter(text, shape, texture, remarks)
    if kind not in _SHAPES:
        raise InputError(f"indenter {text!r} is not understood; allowed: {ALLOWED}")
    counts, build = _SHAPES[kind]
    words = value.split("x", max(counts) - 1)
    if len(words) not in counts:
        raise InputError(f"indenter {text!r} is not understood; allowed: {ALLOWED}")
    return Indenter(text, build(text, *words), texture)


def _sphere(text: str, radius: str) -> Ball:
    return Ball(_length_m(text, radius))


def _cylinder(text: str, radius: str) -> TriangleMesh:
    return cylinder_mesh(_length_m(text, radius), _HEIGHT_M)


def _box(text: str, x: str, y: str) -> TriangleMesh:
    return box_mesh((_length_m(text, x), _length_m(text, y), _HEIGHT_M))


def _roller(text: str, radius: str, length: str) -> TriangleMesh:
    return roller_mesh(_length_m(text, radius), _length_m(text, length))


def _edge(text: str, angle: str, length: str, radius: str | None = None) -> TriangleMesh:
    opening = _number(text, angle)
    low, high = _ANGLE_LIMITS_DEG
    if not low <= opening <= high:
        raise InputError(
            f"indenter {text!r}: an opening angle must lie in [{low:g}, {high:g}] deg, got "
            f"{angle} deg"
        )
    rounding = 0.0 if radius is None else _length_m(text, radius)
    try:
        return edge_mesh(opening, _length_m(text, length), rounding)
    except InputError as error:
        raise InputError(f"indenter {text!r}: {error}") from None


def _grating(text: str, pitch: str, ridges: str, length: str) -> TriangleMesh:
    count = _number(text, ridges)
    low, high = _RIDGE_LIMITS
    if count % 1 or not low <= count <= high:
        raise InputError(
            f"indenter {text!r}: the ridges must be a whole number in [{low}, {high}], got {ridges}"
        )
    pitch_m = _length_m(text, pitch)
    if pitch_m * count * 1e3 > _SIZE_LIMITS_MM[1]:
        raise InputError(
            f"indenter {text!r} is {pitch_m * count * 1e3:g} mm wide; at most "
            f"{_SIZE_LIMITS_MM[1]:g} mm is allowed"
        )
    return grating_mesh(pitch_m, int(count), _length_m(text, length))


def _pair(text: str, radius: str, gap: str) -> TriangleMesh:
    return pair_mesh(_length_m(text, radius), _length_m(text, gap))


_SHAPES: dict[str, tuple[tuple[int, ...], Callable[..., Ball | TriangleMesh]]] = {
    "sphere": ((1,), _sphere),
    "cylinder": ((1,), _cylinder),
    "box": ((2,), _box),
    "roller": ((2,), _roller),
    "edge": ((2, 3), _edge),
    "grating": ((3,), _grating),
    "pair": ((2,), _pair),
}
"""How many numbers follow each name, and what makes the shape of them."""


def _number(text: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(
            f"indenter {text!r}: {value!r} is not a number; allowed: {ALLOWED}"
        ) from None


def _length_m(text: str, value: str) -> float:
    length_mm = _number(text, value)
    low, high = _SIZE_LIMITS_MM
    if not (math.isfinite(length_mm) and low <= length_mm <= high):
        raise InputError(
            f"indenter {text!r}: a size must lie in [{low:g}, {high:g}] mm, got {value} mm"
        )
    return length_mm * 1e-3


def _read_mesh(text: str) -> tuple[TriangleMesh, tuple[str, ...]]:
    """The mesh of a file, and what was changed about it."""
    name, _, axis = text.rpartition("@")
    path, axis = (Path(name), axis) if name and axis in _INTO_GEL else (Path(text), "-z")
    what = f"indenter mesh {path}"
    points, faces = read_triangle_file(path)
    size = float(np.ptp(points, axis=0).max())
    low, high = _LEAST_PART_MM, _SIZE_LIMITS_MM[1]
    if not low <= size <= high:
        raise InputError(
            f"{what} is {size:g} mm across; a size in [{low:g}, {high:g}] mm is needed. "
            f"Its numbers count as millimetres; {other_readings(size, 'millimetres')}. Scale it"
        )
    farthest = float(np.abs(points).max())
    if farthest > high:
        raise InputError(
            f"{what} reaches {farthest:g} mm from its origin, which is what a press puts at its "
            f"place; at most {high:g} mm. Move the object to the origin of its file"
        )
    check_edges(points, faces, what, closed=True)
    points = points @ np.array(_INTO_GEL[axis], dtype=np.float64).T
    faces, turned = turned_outward(points, faces)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    corners = (points - centre)[faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = float(np.einsum("fi,fi->", corners[:, 0], crosses)) / 6
    thickness = 4 * abs(volume) / float(np.linalg.norm(crosses, axis=1).sum())
    if not thickness >= _MIN_THICKNESS_MM:
        raise InputError(
            f"{what} encloses {abs(volume):.3g} mm^3, {thickness:.3g} mm thick on average; a body "
            f"of at least {_MIN_THICKNESS_MM:g} mm is needed, a sheet has no inside"
        )
    check_surface(points, faces, what, closed=True)
    remarks: tuple[str, ...] = ()
    if turned:
        count = int(piece_of_cells(faces).max()) + 1
        which = "it was" if count == 1 else f"{turned} of its {count} parts were"
        remarks = (f"{what}: {which} inside out, and turned round: all faces look outwards now",)
    return TriangleMesh(points * 1e-3, faces), remarks
