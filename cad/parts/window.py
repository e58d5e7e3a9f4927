# SPDX-License-Identifier: Apache-2.0
"""The rigid transparent part behind the gel: a plate with rounded corners, or a dome shell.

Its own frame: origin in the middle of the face that the gel is glued to (a dome's apex), z towards
the gel.
"""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math

from build123d import Face, Location, Plane, Pos, Solid, Vector, Wire

from taccel_lab.cad.parts.part import Part
from taccel_lab.cad.parts.solids import grown, imprint, prism, rounded_rectangle
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import Window

_COLOR = (0.72, 0.86, 0.90)
_FACE_COLORS = {
    "bond": (0.20, 0.42, 0.70),
    "optical_front": (0.45, 0.78, 0.85),
    "optical_back": (0.45, 0.78, 0.85),
}
_ON_FACE_MM = 1e-6
CORNER_RADIUS_MM = 1.0
"""Corner radius of a plate that does not follow the gel's outline."""
MIN_BOND_MM = 0.05
"""Least width of the bond around the optical patch for the patch to be a separate face."""
SAME_OUTLINE_MM = 0.1
"""A plate whose size exceeds the gel's by the same on both axes, within this, takes its outline."""
OUTLINE_REACH_MM = 1.0
"""The greatest difference of size, to one side, at which a plate takes the gel's outline."""


def dome_depth_mm(window: Window) -> float:
    """Height of the dome from its base to its apex [mm]; a hemisphere at most."""
    radius, foot = window.outer_radius_mm, min(window.size_mm) / 2
    if foot > radius + 1e-9:
        raise InputError(
            f"a dome window of radius {radius:g} mm cannot have a base of {2 * foot:g} mm; "
            f"allowed: up to {2 * radius:g} mm"
        )
    depth = radius - math.sqrt(max(radius**2 - foot**2, 0.0))
    if depth <= window.thickness_mm:
        raise InputError(
            f"a dome window of radius {radius:g} mm on a base of {2 * foot:g} mm is {depth:.3f} mm "
            f"high; it must exceed its thickness of {window.thickness_mm:g} mm"
        )
    return depth


def window_part(
    window: Window, gel_outline: Wire | None = None, view_mm: tuple[float, float] = (0.0, 0.0)
) -> Part:
    """The window with its faces "bond", "optical_front", "optical_back", "seat" and "side".

    A plate follows ``gel_outline`` when its size differs from the outline's by the same amount on
    both axes (a window cut like the gel); otherwise it is a rounded rectangle. What the camera sees
    of its front, ``view_mm``, is a separate face; (0, 0) for all of it.
    """
    is_dome = window.shape == "dome"
    solid = _dome(window) if is_dome else _plate(window, gel_outline, view_mm)
    name_of = _dome_face if is_dome else _plate_face
    return Part(
        name="window",
        solid=solid,
        face_names=tuple(name_of(window, face) for face in solid.faces()),
        color=_COLOR,
        material="clear acrylic, polished",
        face_colors=_FACE_COLORS,
    )


def _plate(window: Window, gel_outline: Wire | None, view_mm: tuple[float, float]) -> Solid:
    top = rounded_rectangle(window.size_mm, CORNER_RADIUS_MM)
    if gel_outline is not None:
        box = gel_outline.bounding_box()
        grow = [(window.size_mm[0] - box.size.X) / 2, (window.size_mm[1] - box.size.Y) / 2]
        if abs(grow[0] - grow[1]) <= SAME_OUTLINE_MM / 2 and abs(grow[0]) <= OUTLINE_REACH_MM:
            middle = box.center()
            top = Pos(-middle.X, -middle.Y, 0) * grown(gel_outline, (grow[0] + grow[1]) / 2, 0)
    return _with_patch(prism(top, -window.thickness_mm), view_mm)


def _with_patch(plate: Solid, view_mm: tuple[float, float]) -> Solid:
    """Split the bond face into the optical patch and the rest, where there is a rest."""
    x, y = view_mm[0] / 2, view_mm[1] / 2
    if not (x and y):
        return plate
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]
    front = next(face for face in plate.faces() if abs(face.center().Z) < _ON_FACE_MM)
    inside = [front.is_inside(Vector(*c), _ON_FACE_MM) for c in corners]
    wire = Wire.make_polygon(corners, close=True)
    if not all(inside) or front.outer_wire().distance_to(wire) < MIN_BOND_MM:
        return plate
    return imprint(plate, front, wire)


def _plate_face(window: Window, face: Face) -> str:
    box = face.bounding_box()
    if box.max.Z < -window.thickness_mm + _ON_FACE_MM:
        return "optical_back"
    if box.min.Z > -_ON_FACE_MM:
        optical = not face.inner_wires()
        return "optical_front" if optical else "bond"
    return "side"


def _dome(window: Window) -> Solid:
    radius, depth = window.outer_radius_mm, dome_depth_mm(window)
    middle = Plane(Location((0, 0, -radius)))
    outer = Solid.make_sphere(radius, middle)
    inner = Solid.make_sphere(radius - window.thickness_mm, middle)
    return outer.cut(inner, _below(-depth, 4 * radius)).solids()[0]


def _below(z_mm: float, size_mm: float) -> Solid:
    corner = Plane((-size_mm / 2, -size_mm / 2, z_mm - size_mm))
    return Solid.make_box(size_mm, size_mm, size_mm, corner)


def _dome_face(window: Window, face: Face) -> str:
    if face.bounding_box().max.Z < -dome_depth_mm(window) + 1e-4:
        return "seat"
    point = face.position_at(0.5, 0.5) - Vector(0, 0, -window.outer_radius_mm)
    middle = window.outer_radius_mm - window.thickness_mm / 2
    return "bond" if point.length > middle else "optical_back"
