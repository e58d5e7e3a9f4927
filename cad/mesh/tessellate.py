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
from taccel_lab.cad.parts.part import LabelledSolid
from taccel_lab.errors import InputError

_WELD_MM = 1e-5


def tessellate_solid(
    part: LabelledSolid, *, tolerance_mm: float = 0.003, angle_rad: float = 0.05
) -> LabelledSurface:
    """Triangulate ``part`` to about ``tolerance_mm``, faces welded, each triangle labelled.

    The kernel holds the tolerance on edges and misses it on crowned faces by up to five times.
    """
    welded, triangles, face_of = tessellated_faces(
        part, tolerance_mm=tolerance_mm, angle_rad=angle_rad
    )
    check_closed(triangles, "the tessellated pad")
    regions = np.array([int(region) for region in part.regions], dtype=np.int32)
    return LabelledSurface(welded, triangles, regions[face_of])


def tessellated_faces(
    part: LabelledSolid, *, tolerance_mm: float, angle_rad: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gives, as ``tessellate_solid``, vertices [mm], [n, 3], triangles, [m, 3], and the number of
    each one's face, [m]; a shell may be open."""
    if not (1e-4 <= tolerance_mm <= 1 and 0.01 <= angle_rad <= 1):
        raise InputError(
            f"tolerance_mm = {tolerance_mm:g}, angle_rad = {angle_rad:g}: allowed are 1e-4 to 1 mm "
            "and 0.01 to 1 rad"
        )
    # Meshed as one solid, so that faces share the points of their common edges.
    BRepMesh_IncrementalMesh(part.solid.wrapped, tolerance_mm, False, angle_rad, False)
    vertices, triangles, face_of, offset = [], [], [], 0
    for number, face in enumerate(part.solid.faces()):
        location = TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(face.wrapped, location)
        if mesh is None:
            raise InputError(f"the CAD kernel could not triangulate face {number}")
        transform = location.Transformation()
        points = [mesh.Node(i + 1).Transformed(transform) for i in range(mesh.NbNodes())]
        corners = np.array([mesh.Triangle(i + 1).Get() for i in range(mesh.NbTriangles())]) - 1
        if face.wrapped.Orientation() == TopAbs_Orientation.TopAbs_REVERSED:
            corners = corners[:, ::-1]
        vertices.append(np.array([[p.X(), p.Y(), p.Z()] for p in points]))
        triangles.append(corners + offset)
        face_of.append(np.full(len(corners), number, dtype=np.int32))
        offset += len(points)
    welded, faces = weld(np.concatenate(vertices), np.concatenate(triangles), _WELD_MM)
    real = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return welded, faces[real], np.concatenate(face_of)[real]
