# SPDX-License-Identifier: Apache-2.0
"""STL files in millimetres."""

from __future__ import annotations

from pathlib import Path

from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.part import Part
from taccel_lab.geometry import Region, stl


def write_stl(surface: LabelledSurface, path: Path, *, name: str = "gel pad") -> None:
    """Write a closed surface as binary STL in mm; STL itself names no unit."""
    corners = surface.vertices_mm[surface.triangles]
    stl.write_stl(path, corners, f"taccel_lab {name}, millimetres")


def write_part_stl(part: Part, path: Path) -> None:
    """Write one part in its own frame as binary STL in mm, to 0.01 mm."""
    labelled = LabelledSolid(part.own_solid, [Region.SIDE] * len(part.face_names))
    surface = tessellate_solid(labelled, tolerance_mm=0.01, angle_rad=0.1)
    write_stl(surface, path, name=part.name)
