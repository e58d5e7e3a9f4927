# SPDX-License-Identifier: Apache-2.0
"""A closed triangle surface whose triangles say which region of the pad they belong to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.geometry.connectivity import pieces_of_pairs

_PROBES = 600
_OPPOSITE = -0.9
_AREA_SHARE = 1e-6


@dataclass(frozen=True)
class LabelledSurface:
    """Triangles of a part's boundary, in millimetres."""

    vertices_mm: np.ndarray
    """float64, shape [vertex_count, 3]."""
    triangles: np.ndarray
    """Outward (right-hand rule), int32, shape [triangle_count, 3]."""
    regions: np.ndarray
    """``Region`` of each triangle, int32, shape [triangle_count]."""

    def normals(self) -> np.ndarray:
        """Unit outward normal of each triangle, shape [triangle_count, 3]."""
        cross = self._crosses()
        return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)

    def areas_mm2(self) -> np.ndarray:
        """Area of each triangle [mm^2], shape [triangle_count]."""
        return 0.5 * np.linalg.norm(self._crosses(), axis=1)

    def of(self, *regions: Region) -> np.ndarray:
        """Triangles of the given regions, [n, 3]."""
        return self.triangles[np.isin(self.regions, [int(region) for region in regions])]

    def volume_mm3(self) -> float:
        """Enclosed volume [mm^3]."""
        return enclosed_volume(self.vertices_mm[self.triangles])

    def _crosses(self) -> np.ndarray:
        return doubled_areas(self.vertices_mm[self.triangles])


def doubled_areas(corners: np.ndarray) -> np.ndarray:
    """Normals of triangles, twice as long as their areas, [n, 3, 3] -> [n, 3]."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def enclosed_volume(corners: np.ndarray) -> float:
    """Volume inside closed triangles, below 0 when they face inward, [n, 3, 3]."""
    return float((corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6)


def check_closed(triangles: np.ndarray, what: str) -> None:
    """Raise InputError unless every directed edge has exactly one opposite partner."""
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    size = int(triangles.max()) + 1
    keys = directed[:, 0].astype(np.int64) * size + directed[:, 1]
    opposite = directed[:, 1].astype(np.int64) * size + directed[:, 0]
    repeated = len(keys) - len(np.unique(keys))
    unmatched = int((~np.isin(keys, opposite)).sum())
    if repeated or unmatched:
        raise InputError(
            f"{what} is not a closed manifold surface: {unmatched} open and {repeated} repeated "
            "edges; repair it in the program that it comes from"
        )


def weld(vertices: np.ndarray, triangles: np.ndarray, tolerance: float) -> tuple[
    np.ndarray, np.ndarray
]:  # fmt: skip
    """Merge vertices closer than ``tolerance`` and drop triangles that collapse.

    Returns vertices, shape [n, 3], and triangles, shape [m, 3], int32.
    """
    from scipy.spatial import KDTree

    pairs = KDTree(vertices).query_pairs(tolerance, output_type="ndarray")
    group = pieces_of_pairs(pairs, len(vertices))
    _, first = np.unique(group, return_index=True)
    welded = group[triangles].astype(np.int32)
    return vertices[first], welded


def least_thickness(vertices: np.ndarray, triangles: np.ndarray) -> tuple[float, np.ndarray]:
    """Least thickness seen from the middles of triangles, straight inward, and where it is.

    A ray counts where it meets a face that looks the other way, so that the sharp edge between two
    faces is not taken for a thin sheet. Up to about 1,000 triangles are probed, evenly; infinite
    when no ray meets such a face.
    """
    corners = vertices[triangles]
    cross = doubled_areas(corners)
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(2 * areas, 1e-300)[:, None]
    real = np.flatnonzero(areas > _AREA_SHARE * areas.sum())
    probes = real[:: max(len(real) // _PROBES, 1)]
    starts = corners[probes].mean(axis=1)
    best, where = np.inf, np.zeros(3)
    for k, start in zip(probes, starts, strict=True):
        opposite = normals @ normals[k] < _OPPOSITE
        distance = _first_hit(start, -normals[k], corners[opposite])
        if distance < best:
            best, where = distance, start
    return float(best), where


def _first_hit(start: np.ndarray, direction: np.ndarray, corners: np.ndarray) -> float:
    """Distance along a ray to the nearest of some triangles (Moeller and Trumbore, 1997)."""
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, edge2)
    determinant = (edge1 * p).sum(axis=1)
    good = np.abs(determinant) > 1e-300
    inverse = np.where(good, 1 / np.where(good, determinant, 1), 0)
    offset = start - corners[:, 0]
    u = (offset * p).sum(axis=1) * inverse
    q = np.cross(offset, edge1)
    v = (q @ direction) * inverse
    t = (edge2 * q).sum(axis=1) * inverse
    hit = good & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > -1e-9)
    return float(t[hit].min(initial=np.inf))
