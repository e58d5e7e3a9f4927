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
from taccel_lab.bodies.surface_topology import turned_outward
from taccel_lab.errors import InputError, naming
from taccel_lab.files.triangle_file import read_triangle_file
from taccel_lab.geometry.connectivity import piece_of_cells
from taccel_lab.geometry.length_units import other_readings
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.guards import nearest
from taccel_lab.scene import Ball, TriangleMesh, box_mesh, cylinder_mesh
from taccel_lab.signals.texture import Texture
from taccel_lab.typed import typed

ALLOWED = (
    "sphere:RADIUS, cylinder:RADIUS (flat end), box:XxY (flat end), roller:RADIUSxLENGTH (lies "
    "along y), edge:ANGLExLENGTH[xRADIUS] (wedge along y, opening angle in degrees), "
    "grating:PITCHxRIDGESxLENGTH (ridges along y, half a pitch wide), pair:RADIUSxGAP (two round "
    "pins along x) or mesh:FILE[@AXIS] (STL, PLY or OBJ, placed by its own origin and axes; AXIS, "
    "of +x -x +y -y +z -z, points into the gel, -z when left out); lengths in mm"
)
_BODY_M = 4e-3
"""Height of a cylinder and a box, and of what carries the working part of others."""
_ROUND_SEGMENTS = 128
"""Segments of a full turn: the chords of a roller of 2 mm dip by 0.6 um."""
_TIP_SEGMENTS = 12
_PIN_SEGMENTS = 32
_PIN_RINGS = 8
_SIZE_LIMITS_MM = (0.05, 100.0)
_LEAST_PART_MM = 0.1
"""Least size of a mesh: the narrowest contact that elements are made for."""
_LARGEST_PART_MM = 1e3
"""Largest size of a mesh that is no file's."""
_MIN_THICKNESS_MM = 1e-3
"""Least thickness of a mesh: volume over half of its surface; coordinates of single precision hold
1e-5 mm."""
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
    """Name as given on the command line."""
    shape: Ball | TriangleMesh
    texture: Texture | None = None
    """What stands out of the shape, whose surface is its mean; depths count from first touch of its
    highest points. Images show it, the solver presses the shape."""
    remarks: tuple[str, ...] = ()
    """What was changed to read it, a sentence each."""

    def contact(self, depth_mm: float) -> float | ToolSection:
        """Estimates what of a gel a press touches, by the shape's section at half of the depth. It
        is a ball's radius there [mm], which is Hertz's, else the section itself."""
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


@typed
def parse_indenter(text: str | Path, texture: Texture | None = None) -> Indenter:
    """Read an indenter description, or a mesh by its path; raises InputError that lists what is
    allowed. ``texture``: laid over its surface."""
    text = f"mesh:{text}" if isinstance(text, Path) else text
    kind, _, value = text.partition(":")
    if kind == "mesh":
        shape, remarks = _read_mesh(value)
        return Indenter(text, shape, texture, remarks)
    if kind not in _SHAPES:
        meant = nearest(kind, (*_SHAPES, "mesh"))
        raise InputError(f"indenter {text!r} is not understood{meant}; allowed: {ALLOWED}")
    counts, build = _SHAPES[kind]
    words = value.split("x", max(counts) - 1)
    if len(words) not in counts:
        raise InputError(f"indenter {text!r} is not understood; allowed: {ALLOWED}")
    return Indenter(text, build(text, *words), texture)


def _sphere(text: str, radius: str) -> Ball:
    return Ball(_length_m(text, radius))


def _cylinder(text: str, radius: str) -> TriangleMesh:
    return cylinder_mesh(_length_m(text, radius), _BODY_M)


def _box(text: str, x: str, y: str) -> TriangleMesh:
    return box_mesh((_length_m(text, x), _length_m(text, y), _BODY_M))


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


# Prisms along y and rows of pins, closed: centred on the origin in x and y, the lowest side to -z.


def _prism(outline: np.ndarray, triangles: np.ndarray, length_m: float) -> TriangleMesh:
    """Sweep a triangulated section along y.

    ``outline``: corners (x, z) [m], [n, 2]; ``triangles``: its triangulation, counter-clockwise in
    (x, z), whose edges that belong to one triangle alone bound it, [m, 3].
    """
    n, half = len(outline), length_m / 2
    front = np.stack([outline[:, 0], np.full(n, -half), outline[:, 1]], axis=1)
    back = front + [0.0, length_m, 0.0]
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    known = {(int(a), int(b)) for a, b in edges}
    border = np.array([(a, b) for a, b in known if (b, a) not in known])
    a, b = border[np.lexsort(border.T)].T
    # Seen from -y, where x points right and z up, counter-clockwise triangles look outwards.
    faces = np.concatenate([
        triangles, triangles[:, ::-1] + n,
        np.stack([a, a + n, b + n], axis=1), np.stack([a, b + n, b], axis=1),
    ])  # fmt: skip
    return TriangleMesh(np.concatenate([front, back]), faces)


def _fan(count: int) -> np.ndarray:
    """Triangles of a convex polygon whose corners go round counter-clockwise."""
    i = np.arange(1, count - 1)
    return np.stack([np.zeros_like(i), i, i + 1], axis=1)


def roller_mesh(radius_m: float, length_m: float) -> TriangleMesh:
    """A cylinder that lies on its side, its axis along y through the origin."""
    angle = np.arange(_ROUND_SEGMENTS) * (2 * np.pi / _ROUND_SEGMENTS) - np.pi / 2
    outline = radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return _prism(outline, _fan(_ROUND_SEGMENTS), length_m)


def edge_mesh(opening_deg: float, length_m: float, radius_m: float = 0.0) -> TriangleMesh:
    """A wedge with its edge along y, pointing down; ``radius_m`` rounds the edge, 0 is sharp."""
    half = math.radians(opening_deg) / 2
    # Where the flanks leave the rounding, whose centre lies radius_m over the lowest point.
    if radius_m > 0:
        turn = np.linspace(-(np.pi / 2 - half), np.pi / 2 - half, _TIP_SEGMENTS + 1)
        tip = radius_m * np.stack([np.sin(turn), 1 - np.cos(turn)], axis=1)
    else:
        tip = np.zeros((1, 2))
    # A blunt wedge is cut off at the sides: the flanks end where it is as wide as twice its height.
    rise = min(_BODY_M, _BODY_M / math.tan(half))
    if rise <= tip[-1, 1]:
        raise InputError(
            f"an edge of {opening_deg:g} deg rounded by {radius_m * 1e3:g} mm leaves no flanks; "
            "use a smaller radius"
        )
    out = tip[-1, 0] + (rise - tip[-1, 1]) * math.tan(half)
    outline = np.concatenate([tip, [[out, rise], [-out, rise]]])
    outline[:, 1] -= rise / 2
    return _prism(outline, _fan(len(outline)), length_m)


def grating_mesh(pitch_m: float, ridges: int, length_m: float) -> TriangleMesh:
    """Parallel ridges along y, half a pitch wide and one pitch high, on a plate."""
    left = (np.arange(ridges) - (ridges - 1) / 2 - 0.25) * pitch_m
    x = np.stack([left, left + pitch_m / 2], axis=1).ravel()
    plate = max(pitch_m, 1e-3)
    low = -(pitch_m + plate) / 2
    levels = (low, low + pitch_m, low + pitch_m + plate)
    count = len(x)
    outline = np.concatenate([np.stack([x, np.full(count, z)], axis=1) for z in levels])
    strips = [(k, level) for k in range(0, count - 1, 2) for level in (0, 1)]
    strips += [(k, 1) for k in range(1, count - 1, 2)]
    triangles = []
    for k, level in strips:
        a = k + level * count
        b, c, d = a + 1, a + 1 + count, a + count
        triangles += [(a, b, c), (a, c, d)]
    return _prism(outline, np.array(triangles), length_m)


def pair_mesh(radius_m: float, gap_m: float) -> TriangleMesh:
    """Two upright pins with round tips side by side along x, ``gap_m`` between them."""
    pin = _pin(radius_m)
    offset = np.array([radius_m + gap_m / 2, 0.0, 0.0])
    vertices = np.concatenate([pin.vertices_m - offset, pin.vertices_m + offset])
    return TriangleMesh(vertices, np.concatenate([pin.faces, pin.faces + len(pin.vertices_m)]))


def _pin(radius_m: float) -> TriangleMesh:
    """A pin along z: a half sphere below, a flat end above."""
    turn = 2 * np.pi / _PIN_SEGMENTS * np.arange(_PIN_SEGMENTS)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    height = radius_m + _BODY_M
    polar = 0.5 * np.pi * np.arange(1, _PIN_RINGS + 1) / _PIN_RINGS
    loops = [(radius_m * math.sin(a), radius_m * (1 - math.cos(a))) for a in polar]
    loops.append((radius_m, height))
    vertices = [np.column_stack([r * ring, np.full(_PIN_SEGMENTS, z)]) for r, z in loops]
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height]])
    nodes = np.concatenate([*vertices, ends]) - [0.0, 0.0, height / 2]
    i = np.arange(_PIN_SEGMENTS)
    j = (i + 1) % _PIN_SEGMENTS
    tip = len(nodes) - 2
    faces = [np.stack([j, i, np.full_like(i, tip)], axis=1)]
    for k in range(len(loops) - 1):
        low, high = k * _PIN_SEGMENTS, (k + 1) * _PIN_SEGMENTS
        faces += [
            np.stack([i + low, j + low, j + high], axis=1),
            np.stack([i + low, j + high, i + high], axis=1),
        ]
    last = (len(loops) - 1) * _PIN_SEGMENTS
    faces.append(np.stack([i + last, j + last, np.full_like(i, tip + 1)], axis=1))
    return TriangleMesh(nodes, np.concatenate(faces))
