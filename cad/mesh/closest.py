# SPDX-License-Identifier: Apache-2.0
"""Closest points on triangle surfaces, by VTK's cell locator."""

from __future__ import annotations

from typing import Any

import numpy as np

from taccel_lab.cad.mesh.surface import doubled_areas


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
