# SPDX-License-Identifier: Apache-2.0
"""The rigid transparent part behind the gel: a plate with rounded corners, or a dome shell.

Its own frame: origin in the middle of the face that the gel is glued to (a dome's apex), z towards
the gel.
"""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from dataclasses import dataclass

from build123d import Face, Location, Plane, Pos, Solid, Vector, Wire

from taccel_lab.cad.parts.outline import grown, prism, rounded_rectangle
from taccel_lab.cad.parts.part import Part
from taccel_lab.cad.parts.solids import imprint
from taccel_lab.errors import InputError

_COLOR = (0.72, 0.86, 0.90)
_FACE_COLORS = {
    "bond": (0.20, 0.42, 0.70),
    "optical_front": (0.45, 0.78, 0.85),
    "optical_back": (0.45, 0.78, 0.85),
}
_ON_FACE_MM = 1e-6
MIN_BOND_MM = 0.05
"""Least width of the bond around the optical patch for the patch to be a face of its own."""
SAME_OUTLINE_MM = 0.1
"""A plate whose size exceeds the gel's by the same on both axes, within this, takes its outline."""
OUTLINE_REACH_MM = 1.0
"""The greatest difference of size, to one side, at which a plate takes the gel's outline."""


@dataclass(frozen=True)
class WindowShape:
    """Dimensions of the window [mm]."""

    thickness_mm: float
    size_mm: tuple[float, float]
    """Extents along x and y; of a dome, of its base."""
    dome_radius_mm: float = 0.0
    """Of a dome: radius of the face that the gel is glued to; 0 for a plate."""
    corner_radius_mm: float = 1.0
    """Of a plate that does not follow the gel's outline."""
    optical_mm: tuple[float, float] = (0.0, 0.0)
    """Extents of what the camera sees, a face of its own in the bond face; 0 for all of it."""
    material: str = "clear acrylic, polished"

    def base_depth_mm(self) -> float:
        """Depth of the window's lowest point under its origin [mm]."""
        if not self.dome_radius_mm:
            return self.thickness_mm
        return dome_depth_mm(self)


def dome_depth_mm(shape: WindowShape) -> float:
    """Height of the dome from its base to its apex [mm]; a hemisphere at most."""
    radius, foot = shape.dome_radius_mm, min(shape.size_mm) / 2
    if foot > radius + 1e-9:
        raise InputError(
            f"a dome window of radius {radius:g} mm cannot have a base of {2 * foot:g} mm; "
            f"allowed: up to {2 * radius:g} mm"
        )
    depth = radius - math.sqrt(max(radius**2 - foot**2, 0.0))
    if depth <= shape.thickness_mm:
        raise InputError(
            f"a dome window of radius {radius:g} mm on a base of {2 * foot:g} mm is {depth:.3f} mm "
            f"high; it must exceed its thickness of {shape.thickness_mm:g} mm"
        )
    return depth


def window_part(shape: WindowShape, gel_outline: Wire | None = None) -> Part:
    """The window with its faces "bond", "optical_front", "optical_back", "seat" and "side".

    A plate follows ``gel_outline`` when its size differs from the outline's by the same amount on
    both axes (a window cut like the gel); otherwise it is a rounded rectangle.
    """
    solid = _dome(shape) if shape.dome_radius_mm else _plate(shape, gel_outline)
    name_of = _dome_face if shape.dome_radius_mm else _plate_face
    return Part(
        name="window",
        solid=solid,
        face_names=tuple(name_of(shape, face) for face in solid.faces()),
        color=_COLOR,
        material=shape.material,
        face_colors=_FACE_COLORS,
    )


def _plate(shape: WindowShape, gel_outline: Wire | None) -> Solid:
    top = rounded_rectangle(shape.size_mm, shape.corner_radius_mm)
    if gel_outline is not None:
        box = gel_outline.bounding_box()
        grow = [(shape.size_mm[0] - box.size.X) / 2, (shape.size_mm[1] - box.size.Y) / 2]
        if abs(grow[0] - grow[1]) <= SAME_OUTLINE_MM / 2 and abs(grow[0]) <= OUTLINE_REACH_MM:
            middle = box.center()
            top = Pos(-middle.X, -middle.Y, 0) * grown(gel_outline, (grow[0] + grow[1]) / 2, 0)
    return _with_patch(prism(top, -shape.thickness_mm), shape)


def _with_patch(plate: Solid, shape: WindowShape) -> Solid:
    """Split the bond face into the optical patch and the rest, where there is a rest."""
    x, y = shape.optical_mm[0] / 2, shape.optical_mm[1] / 2
    if not (x and y):
        return plate
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]
    front = next(face for face in plate.faces() if abs(face.center().Z) < _ON_FACE_MM)
    inside = [front.is_inside(Vector(*c), _ON_FACE_MM) for c in corners]
    wire = Wire.make_polygon(corners, close=True)
    if not all(inside) or front.outer_wire().distance_to(wire) < MIN_BOND_MM:
        return plate
    return imprint(plate, front, wire)


def _plate_face(shape: WindowShape, face: Face) -> str:
    box = face.bounding_box()
    if box.max.Z < -shape.thickness_mm + _ON_FACE_MM:
        return "optical_back"
    if box.min.Z > -_ON_FACE_MM:
        optical = not face.inner_wires()
        return "optical_front" if optical else "bond"
    return "side"


def _dome(shape: WindowShape) -> Solid:
    radius, depth = shape.dome_radius_mm, dome_depth_mm(shape)
    middle = Plane(Location((0, 0, -radius)))
    outer = Solid.make_sphere(radius, middle)
    inner = Solid.make_sphere(radius - shape.thickness_mm, middle)
    return outer.cut(inner, _below(-depth, 4 * radius)).solids()[0]


def _below(z_mm: float, size_mm: float) -> Solid:
    corner = Plane((-size_mm / 2, -size_mm / 2, z_mm - size_mm))
    return Solid.make_box(size_mm, size_mm, size_mm, corner)


def _dome_face(shape: WindowShape, face: Face) -> str:
    if face.bounding_box().max.Z < -shape.base_depth_mm() + 1e-4:
        return "seat"
    point = face.position_at(0.5, 0.5) - Vector(0, 0, -shape.dome_radius_mm)
    middle = shape.dome_radius_mm - shape.thickness_mm / 2
    return "bond" if point.length > middle else "optical_back"
