# SPDX-License-Identifier: Apache-2.0
"""A solid with plane faces from a labelled surface of triangles, for moulds and drawings.

Runs in the readers' process, like all that the CAD kernel does with a stranger's shape.
"""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
from build123d import Solid
from OCP.BRep import BRep_Builder
from OCP.BRepBuilderAPI import (
    BRepBuilderAPI_MakeEdge,
    BRepBuilderAPI_MakeFace,
    BRepBuilderAPI_MakeVertex,
    BRepBuilderAPI_MakeWire,
)
from OCP.gp import gp_Dir, gp_Pln, gp_Pnt
from OCP.ShapeUpgrade import ShapeUpgrade_UnifySameDomain
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Shell, TopoDS_Solid

from taccel_lab.cad.mesh.closest import ClosestPoint
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.mesh.tessellate import tessellated_faces
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

_SAME_VOLUME = 1e-4


def facet_solid(surface: LabelledSurface) -> LabelledSolid:
    """The solid in ``surface``; neighbours in a plane and of a region become one face.

    Raises InputError when the kernel makes another volume of it.
    """
    vertices = [
        BRepBuilderAPI_MakeVertex(gp_Pnt(*p)).Vertex() for p in surface.vertices_mm.tolist()
    ]
    edges: dict[tuple[int, int], tuple[TopoDS_Edge, set[int]]] = {}
    builder, shell = BRep_Builder(), TopoDS_Shell()
    builder.MakeShell(shell)
    corners = surface.vertices_mm[surface.triangles]
    for triangle, region, at, normal in zip(
        surface.triangles.tolist(), surface.regions.tolist(), corners[:, 0], surface.normals(),
        strict=True,
    ):  # fmt: skip
        wire = BRepBuilderAPI_MakeWire()
        for a, b in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            pair = (min(a, b), max(a, b))
            if pair not in edges:
                made = BRepBuilderAPI_MakeEdge(vertices[pair[0]], vertices[pair[1]]).Edge()
                edges[pair] = made, set()
            edge, regions = edges[pair]
            regions.add(region)
            wire.Add(edge if a < b else TopoDS.Edge(edge.Reversed()))
        plane = gp_Pln(gp_Pnt(*at.tolist()), gp_Dir(*normal.tolist()))
        builder.Add(shell, BRepBuilderAPI_MakeFace(plane, wire.Wire(), True).Face())
    shell.Closed(True)
    solid = TopoDS_Solid()
    builder.MakeSolid(solid)
    builder.Add(solid, shell)
    merge = ShapeUpgrade_UnifySameDomain(solid, True, True, False)
    for edge, regions in edges.values():
        if len(regions) > 1:
            merge.KeepShape(edge)
    merge.Build()
    found = Solid(merge.Shape())
    part = LabelledSolid(found, _regions(found, surface))
    wanted = surface.volume_mm3()
    if abs(part.volume_mm3 - wanted) > _SAME_VOLUME * wanted:
        raise InputError(
            f"the CAD kernel makes a solid of {part.volume_mm3:.4g} mm^3 of triangles around "
            f"{wanted:.4g} mm^3"
        )
    return part


def _regions(solid: Solid, surface: LabelledSurface) -> list[Region]:
    """Region of each face: that of the triangles under its own largest one."""
    bare = LabelledSolid(solid, [Region.SIDE] * len(solid.faces()))
    points, triangles, face_of = tessellated_faces(bare, tolerance_mm=0.01, angle_rad=0.1)
    corners = points[triangles]
    areas = LabelledSurface(points, triangles, face_of).areas_mm2()
    largest = np.array([
        np.flatnonzero(face_of == k)[areas[face_of == k].argmax()] for k in range(len(bare.regions))
    ])  # fmt: skip
    _, cells = ClosestPoint(surface.vertices_mm, surface.triangles)(corners[largest].mean(axis=1))
    return [Region(int(region)) for region in surface.regions[cells]]
