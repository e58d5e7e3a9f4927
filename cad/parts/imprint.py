# SPDX-License-Identifier: Apache-2.0
"""A closed line drawn on a face of a solid, which splits the face in two."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from build123d import Face, Solid, Wire
from OCP.BRepFeat import BRepFeat_SplitShape


def imprint(solid: Solid, face: Face, wire: Wire) -> Solid:
    """``solid`` with ``wire``, which lies inside ``face``, as an edge; other faces stay the same.

    Raises ValueError when the kernel gives no single solid.
    """
    split = BRepFeat_SplitShape(solid.wrapped)
    split.Add(wire.wrapped, face.wrapped)
    split.Build()
    found = Solid.cast(split.Shape()).solids()
    if len(found) != 1:
        raise ValueError(f"{len(found)} bodies instead of one after splitting a face")
    return found[0]
