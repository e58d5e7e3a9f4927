# SPDX-License-Identifier: Apache-2.0
"""Closest points on triangle surfaces, by VTK's cell locator; glued nodes exactly on glued faces.

The closest point on the triangles of a plane face is exact only to rounding of its corners, so
nodes of plane faces are then put on the plane itself, fitted to all its triangles at once. Curved
faces have no plane; their nodes lie on the triangles.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from taccel_lab.cad.mesh.surface import LabelledSurface, doubled_areas
from taccel_lab.geometry import Region

Projection = Callable[[np.ndarray], np.ndarray]
"""Points [mm], [n, 3], to the closest points on the glued surface, [n, 3]."""

_SAME_NORMAL = 1e-6
_SAME_OFFSET_MM = 1e-5


class ClosestPoint:
    """Answers which triangle of a surface is nearest to a point, and how far away."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        import pyvista as pv

        self._surface = pv.PolyData.from_regular_faces(
            np.ascontiguousarray(vertices, dtype=np.float64), np.asarray(triangles)
        )

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance [unit of the surface] and triangle index for each point, shape [n] each."""
        nearest, cells = self.project(points)
        return np.linalg.norm(nearest - points, axis=1), cells

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Closest points on the surface, shape [n, 3], and their triangles, shape [n]."""
        found: Any = self._surface.find_closest_cell(points, return_closest_point=True)
        cells, nearest = found
        return np.asarray(nearest, dtype=np.float64), np.asarray(cells)


_SAMPLES = 20_000
Triangles = tuple[np.ndarray, np.ndarray]
"""Vertices, [n, 3], and triangles, [m, 3]."""


def surface_distance(first: Triangles, second: Triangles) -> tuple[float, np.ndarray, float]:
    """Hausdorff distance of two surfaces, sampled both ways, where it is, and the root mean square
    distance of the first from the second."""
    on_first, on_second = surface_samples(*first), surface_samples(*second)
    there, back = ClosestPoint(*second)(on_first)[0], ClosestPoint(*first)(on_second)[0]
    both, points = np.concatenate([there, back]), np.concatenate([on_first, on_second])
    rms = float(np.sqrt((there[-_SAMPLES:] ** 2).mean()))
    return float(both.max()), points[int(both.argmax())], rms


def surface_samples(
    vertices: np.ndarray, triangles: np.ndarray, count: int = _SAMPLES
) -> np.ndarray:
    """All vertices used by ``triangles``, then ``count`` points spread by area, shape [n, 3].

    The points are the same on every call.
    """
    rng = np.random.default_rng(0)
    p = vertices[triangles]
    area = np.linalg.norm(doubled_areas(p), axis=1)
    chosen = p[rng.choice(len(triangles), size=count, p=area / area.sum())]
    u, v = rng.random((2, count, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    inside = chosen[:, 0] + u * (chosen[:, 1] - chosen[:, 0]) + v * (chosen[:, 2] - chosen[:, 0])
    return np.concatenate([vertices[np.unique(triangles)], inside])


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
