# SPDX-License-Identifier: Apache-2.0
"""Puts glued nodes exactly on the glued faces of a triangle surface.

The closest point on the triangles of a plane face is exact only to rounding of its corners, so
nodes of plane faces are then put on the plane itself, fitted to all its triangles at once. Curved
faces have no plane; their nodes lie on the triangles.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.cad.mesh.closest import ClosestPoint
from taccel_lab.cad.mesh.surface import LabelledSurface, doubled_areas
from taccel_lab.geometry import Region

Projection = Callable[[np.ndarray], np.ndarray]
"""Points [mm], [n, 3], to the closest points on the glued surface, [n, 3]."""

_SAME_NORMAL = 1e-6
_SAME_OFFSET_MM = 1e-5


def bond_projection(surface: LabelledSurface) -> Projection:
    """Projection onto the bond and window triangles of ``surface``."""
    glued = np.isin(surface.regions, [int(Region.BOND), int(Region.WINDOW)])
    triangles = surface.triangles[glued]
    closest = ClosestPoint(surface.vertices_mm, triangles)
    normals = surface.normals()[glued]
    plane_of, planes = _planes(surface.vertices_mm[triangles], normals)

    def project(points_mm: np.ndarray) -> np.ndarray:
        nearest, cells = closest.project(np.asarray(points_mm, dtype=np.float64))
        own = plane_of[cells]
        normal, offset = planes[own, :3], planes[own, 3]
        off = (nearest * normal).sum(axis=1) - offset
        on_plane = np.abs(off) < _SAME_OFFSET_MM
        return np.where(on_plane[:, None], nearest - off[:, None] * normal, nearest)

    return project


def _planes(corners: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Plane of each triangle, shape [n], and the planes as normal and offset, shape [m, 4].

    Triangles with the same normal and offset share a plane, taken from the largest of them.
    """
    offsets = (corners.mean(axis=1) * normals).sum(axis=1)
    cross = doubled_areas(corners)
    order = np.argsort(-np.linalg.norm(cross, axis=1))
    plane_of = np.full(len(corners), -1)
    planes: list[np.ndarray] = []
    for k in order:
        if plane_of[k] >= 0:
            continue
        same = np.abs(normals - normals[k]).max(axis=1) < _SAME_NORMAL
        same &= (np.abs(offsets - offsets[k]) < _SAME_OFFSET_MM) & (plane_of < 0)
        normal = _snapped(normals[k])
        plane_of[same] = len(planes)
        planes.append(np.append(normal, (corners[same].reshape(-1, 3) @ normal).mean()))
    return plane_of, np.array(planes)


def _snapped(normal: np.ndarray) -> np.ndarray:
    """A normal along an axis to within rounding becomes exactly that axis."""
    axis = np.round(normal)
    return axis if np.abs(normal - axis).max() < _SAME_NORMAL else normal
