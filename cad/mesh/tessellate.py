# SPDX-License-Identifier: Apache-2.0
"""Closed labelled triangle surface of a pad's solid."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.TopAbs import TopAbs_Orientation
from OCP.TopLoc import TopLoc_Location

from taccel_lab.cad.mesh.surface import LabelledSurface, check_closed, weld
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.errors import InputError

_WELD_MM = 1e-5


def tessellate_solid(
    part: LabelledSolid, *, tolerance_mm: float = 0.003, angle_rad: float = 0.05
) -> LabelledSurface:
    """Triangulate ``part`` to about ``tolerance_mm``, faces welded, each triangle labelled.

    The kernel holds the tolerance on edges and misses it on crowned faces by up to five times.
    """
    if not (1e-4 <= tolerance_mm <= 1 and 0.01 <= angle_rad <= 1):
        raise InputError(
            f"tolerance_mm = {tolerance_mm:g}, angle_rad = {angle_rad:g}: allowed are 1e-4 to 1 mm "
            "and 0.01 to 1 rad"
        )
    # Meshed as one solid, so that faces share the points of their common edges.
    BRepMesh_IncrementalMesh(part.solid.wrapped, tolerance_mm, False, angle_rad, False)
    vertices, triangles, regions, offset = [], [], [], 0
    for face, region in zip(part.solid.faces(), part.regions, strict=True):
        location = TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(face.wrapped, location)
        if mesh is None:
            raise InputError(f"the CAD kernel could not triangulate a {region.name} face")
        transform = location.Transformation()
        points = [mesh.Node(i + 1).Transformed(transform) for i in range(mesh.NbNodes())]
        corners = np.array([mesh.Triangle(i + 1).Get() for i in range(mesh.NbTriangles())]) - 1
        if face.wrapped.Orientation() == TopAbs_Orientation.TopAbs_REVERSED:
            corners = corners[:, ::-1]
        vertices.append(np.array([[p.X(), p.Y(), p.Z()] for p in points]))
        triangles.append(corners + offset)
        regions.append(np.full(len(corners), int(region), dtype=np.int32))
        offset += len(points)
    welded, faces = weld(np.concatenate(vertices), np.concatenate(triangles), _WELD_MM)
    labels = np.concatenate(regions)
    real = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    check_closed(faces[real], "the tessellated pad")
    return LabelledSurface(welded, faces[real], labels[real])
