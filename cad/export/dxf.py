# SPDX-License-Identifier: Apache-2.0
"""DXF files for cutting: outline, window and seat in plan, and a section through the middle."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from build123d import (
    Edge,
    ExportDXF,
    Face,
    Location,
    Plane,
    Pos,
    Solid,
    Unit,
    Wire,
)
from build123d.exporters import ColorIndex
from build123d.topology import Shape

from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.outline import base_outline
from taccel_lab.cad.parts.part import Part
from taccel_lab.cad.parts.solids import section_faces
from taccel_lab.files.atomic_file import write_by
from taccel_lab.geometry import Region

SECTION_GAP_MM = 10.0
"""Distance between the plan and the section drawn under it."""
_LAYERS = {
    "outline": ColorIndex.BLACK,
    "window": ColorIndex.CYAN,
    "seat": ColorIndex.BLUE,
    "section": ColorIndex.RED,
}


def write_dxf(gel: LabelledSolid, path: Path, *, others: Sequence[Part] = ()) -> None:
    """Write the gel in plan at 1:1 in mm (layers "outline", "window"), x right and y up.

    ``others`` in their places add the layer "seat" (edges of faces of that name). The section of
    the plane y = 0 lies under the plan on the layer "section", z up, its highest point
    ``SECTION_GAP_MM`` below the plan.
    """
    dxf = ExportDXF(unit=Unit.MM)
    for name, color in _LAYERS.items():
        dxf.add_layer(name, color=color)
    outline = _flat(base_outline(gel.solid))
    dxf.add_shape(outline, layer="outline")
    for edge in _own_edges(gel.faces(Region.WINDOW)):
        dxf.add_shape(_flat(edge), layer="window")
    for part in others:
        for edge in _own_edges(part.faces("seat")):
            dxf.add_shape(_flat(edge), layer="seat")
    drop = outline.bounding_box().min.Y - SECTION_GAP_MM
    for solid in (gel.solid, *(part.solid for part in others if not part.placeholder)):
        for edge in _section_edges(solid, drop):
            dxf.add_shape(edge, layer="section")
    write_by(path, dxf.write)


def _flat(shape: Edge | Wire) -> Shape:
    """A horizontal edge or wire moved to z = 0."""
    return Pos(0, 0, -shape.bounding_box().min.Z) * shape


def _own_edges(faces: Sequence[Face]) -> list[Edge]:
    """Horizontal edges that bound the faces together, without those between two of them."""
    edges = [edge for face in faces for edge in face.edges()]
    return [
        edge
        for edge in edges
        if sum(edge.is_same(other) for other in edges) == 1 and edge.bounding_box().size.Z < 1e-6
    ]


def _section_edges(solid: Solid, top_y: float) -> list[Edge]:
    """Edges of the section with y = 0, turned into the drawing plane: x right, z up."""
    turn = Location((0, top_y, 0)) * Location((0, 0, 0), (-90, 0, 0))
    return [turn * edge for face in section_faces(solid, Plane.XZ) for edge in face.edges()]
