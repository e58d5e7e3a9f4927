# SPDX-License-Identifier: Apache-2.0
"""What solids need everywhere: the one body of a result, what two have in common, imprints."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from build123d import Face, Plane, ShapeList, Solid, Wire
from build123d.topology import Shape
from OCP.BRepFeat import BRepFeat_SplitShape


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


def imprint(solid: Solid, face: Face, wire: Wire) -> Solid:
    """``solid`` with ``wire``, which lies inside ``face``, as an edge; other faces stay the same.

    Raises ValueError when the kernel gives no single solid.
    """
    split = BRepFeat_SplitShape(solid.wrapped)
    split.Add(wire.wrapped, face.wrapped)
    split.Build()
    return one_solid(Solid.cast(split.Shape()))
