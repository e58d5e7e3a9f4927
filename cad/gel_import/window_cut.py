# SPDX-License-Identifier: Apache-2.0
"""A rectangle cut out of the plane bond of a labelled surface of triangles, as its window."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.cad.mesh.surface import LabelledSurface, doubled_areas
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

_LEVEL_MM = 1e-6
_ON_LINE_MM = 1e-6


def with_window(
    surface: LabelledSurface, size_mm: tuple[float, float], path: Path
) -> LabelledSurface:
    """The surface with a rectangle about the origin of plan [mm] as its window; bond triangles are
    cut along its sides, and so are those that they share edges with.

    Raises InputError when no level bond triangles fill the rectangle.
    """
    half = np.array(size_mm) / 2
    for axis in range(2):
        for side in (-half[axis], half[axis]):
            surface = _cut_level_bond(surface, axis, float(side))
    corners = surface.vertices_mm[surface.triangles]
    middles = corners.mean(axis=1)
    inside = _level_bond(surface) & (np.abs(middles[:, :2]) < half).all(axis=1)
    area = 0.5 * np.linalg.norm(doubled_areas(corners[inside]), axis=1).sum()
    if abs(area - size_mm[0] * size_mm[1]) > 1e-4 * size_mm[0] * size_mm[1]:
        raise no_room(path, size_mm)
    regions = surface.regions.copy()
    regions[inside] = int(Region.WINDOW)
    return LabelledSurface(surface.vertices_mm, surface.triangles, regions)


def no_room(path: Path, size_mm: tuple[float, float]) -> InputError:
    """Refusal of a window that the bond does not hold."""
    return InputError(
        f"{path}: no plane bond face, square to the normal, takes a window of {size_mm[0]:g} x "
        f"{size_mm[1]:g} mm in its middle; choose a smaller one or select window faces"
    )


def _level_bond(surface: LabelledSurface) -> np.ndarray:
    heights = surface.vertices_mm[surface.triangles][..., 2]
    return (surface.regions == int(Region.BOND)) & (np.ptp(heights, axis=1) < _LEVEL_MM)


def _cut_level_bond(surface: LabelledSurface, axis: int, at_mm: float) -> LabelledSurface:
    """Level bond triangles cut where a coordinate has a value."""
    points, triangles = surface.vertices_mm, surface.triangles.astype(np.int64)
    away = points[:, axis] - at_mm
    away = np.where(np.abs(away) < _ON_LINE_MM, 0.0, away)
    bond = triangles[_level_bond(surface)]
    edges = np.unique(np.sort(bond[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    edges = edges[away[edges[:, 0]] * away[edges[:, 1]] < 0]
    if not len(edges):
        return surface
    start, end = away[edges].T
    share = (start / (start - end))[:, None]
    cuts = points[edges[:, 0]] * (1 - share) + points[edges[:, 1]] * share
    cuts[:, axis] = at_mm
    middle = {(int(a), int(b)): len(points) + k for k, (a, b) in enumerate(edges)}
    kept, pieces, labels = [], [], []
    for triangle, region in zip(triangles.tolist(), surface.regions.tolist(), strict=True):
        whole = [triangle]
        for pair, cut in ((_pair(triangle, k), k) for k in range(3)):
            if pair in middle:
                whole = _halved(whole, triangle[cut], triangle[(cut + 1) % 3], middle[pair])
        (pieces if len(whole) > 1 else kept).extend(whole)
        labels.append((region, len(whole)))
    regions = [r for r, n in labels if n == 1] + [r for r, n in labels if n > 1 for _ in range(n)]
    return LabelledSurface(
        np.concatenate([points, cuts]),
        np.array(kept + pieces, dtype=np.int32),
        np.array(regions, dtype=np.int32),
    )


def _pair(triangle: list[int], k: int) -> tuple[int, int]:
    a, b = triangle[k], triangle[(k + 1) % 3]
    return min(a, b), max(a, b)


def _halved(whole: list[list[int]], start: int, end: int, middle: int) -> list[list[int]]:
    """Triangles cut at the middle of the one edge from ``start`` to ``end``."""
    found = []
    for triangle in whole:
        for k in range(3):
            if triangle[k] == start and triangle[(k + 1) % 3] == end:
                apex = triangle[(k + 2) % 3]
                found += [[start, middle, apex], [middle, end, apex]]
                break
        else:
            found.append(triangle)
    return found
