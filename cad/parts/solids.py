# SPDX-License-Identifier: Apache-2.0
"""What solids need everywhere: the one body of a result, what two have in common, imprints.

Outlines in plan: where a body stands, rounded rectangles, walls pulled up from them.
"""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
from build123d import (
    BoundBox,
    Face,
    Kind,
    Plane,
    Pos,
    RectangleRounded,
    ShapeList,
    Solid,
    Vector,
    Wire,
)
from build123d.topology import Shape
from OCP.BRepFeat import BRepFeat_SplitShape
from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism
from OCP.gp import gp_Vec

from taccel_lab.errors import InputError

_SECTION_LIFT_MM = 1e-3
_SILHOUETTE_TOLERANCE_MM = 5e-3


def one_solid(shape: Shape | ShapeList | None) -> Solid:
    """The single body that an operation left; raises ValueError when there is none or more."""
    solids = shape.solids() if shape is not None else []
    if len(solids) != 1:
        raise ValueError(f"{len(solids)} bodies instead of one")
    return solids[0]


def section_faces(solid: Solid, plane: Plane) -> list[Face]:
    """What a plane cuts out of a solid, by place: the kernel's order changes from run to run."""
    faces = [face for shape in solid.intersect(plane) or [] for face in shape.faces()]
    return sorted(faces, key=lambda face: tuple(round(c, 6) for c in face.center()))


def common_volume_mm3(first: Solid, second: Solid) -> float:
    """Volume that two solids have in common [mm^3]."""
    both = first & second
    return 0.0 if both is None else float(sum(solid.volume for solid in both.solids()))


class FacesNear:
    """The faces of a solid with their boxes, so that a point is held against those near it alone:
    the kernel's distance to a solid of 700 faces takes 60 ms."""

    def __init__(self, solid: Solid) -> None:
        self._faces = solid.faces()
        boxes = [face.bounding_box() for face in self._faces]
        self._low = np.array([tuple(box.min) for box in boxes])
        self._high = np.array([tuple(box.max) for box in boxes])

    def touch(self, point: Vector, within_mm: float) -> bool:
        """Whether a face lies less than ``within_mm`` from a point."""
        at = np.array(tuple(point))
        near = ((at > self._low - within_mm) & (at < self._high + within_mm)).all(axis=1)
        return any(self._faces[k].distance_to(point) < within_mm for k in np.flatnonzero(near))


def imprint(solid: Solid, face: Face, wire: Wire) -> Solid:
    """``solid`` with ``wire``, which lies inside ``face``, as an edge; other faces stay the same.

    Raises ValueError when the kernel gives no single solid.
    """
    split = BRepFeat_SplitShape(solid.wrapped)
    split.Add(wire.wrapped, face.wrapped)
    split.Build()
    return one_solid(Solid.cast(split.Shape()))


def prism(face: Face, height_mm: float) -> Solid:
    """``face`` pulled along z by ``height_mm``, negative downwards.

    The far face is a copy, no moved twin of the near one: STEP files lose the names of twins.
    """
    return Solid(BRepPrimAPI_MakePrism(face.wrapped, gp_Vec(0, 0, height_mm), True).Shape())


def rounded_rectangle(
    size_mm: tuple[float, float],
    radius_mm: float,
    z_mm: float = 0.0,
    center_mm: tuple[float, float] = (0.0, 0.0),
) -> Face:
    """A rectangle with rounded corners in the plane at ``z_mm``, facing +z.

    The radius shrinks to what the size leaves room for.
    """
    radius = min(radius_mm, 0.499 * min(size_mm))
    return (Pos(*center_mm, z_mm) * RectangleRounded(*size_mm, radius)).faces()[0]


def base_outline(solid: Solid, box: BoundBox | None = None) -> Wire:
    """Outline of the body where it stands, at its lowest z; ``box``: its bounding box, where that
    is known.

    Raises InputError when the body stands on several feet or juts out above its base.
    """
    box = box or solid.bounding_box()
    faces = section_faces(solid, Plane.XY.offset(box.min.Z + _SECTION_LIFT_MM))
    if len(faces) != 1:
        raise InputError(f"the body stands on {len(faces)} separate faces; one outline is needed")
    wire: Wire = Pos(0, 0, -_SECTION_LIFT_MM) * faces[0].outer_wire()
    base = wire.bounding_box()
    over = max(base.min.X - box.min.X, base.min.Y - box.min.Y, box.max.X - base.max.X,
               box.max.Y - base.max.Y)  # fmt: skip
    if over > _SILHOUETTE_TOLERANCE_MM:
        raise InputError(
            f"the body juts out {over:.3f} mm beyond its base; it has to be widest where it is "
            "glued"
        )
    return wire


def grown(wire: Wire, distance_mm: float, z_mm: float) -> Face:
    """The area inside ``wire`` (a plane one), grown by a distance, moved to ``z_mm``, facing +z."""
    if abs(distance_mm) > 1e-9:
        moved = wire.offset_2d(distance_mm, kind=Kind.ARC)
        wire = moved if isinstance(moved, Wire) else Wire([moved])
    face = Face(wire)
    if face.normal_at().Z < 0:
        face = -face
    return Pos(0, 0, z_mm - face.center().Z) * face
