# SPDX-License-Identifier: Apache-2.0
"""Convex polygons: corners counter-clockwise, shape [n, 2]."""

from __future__ import annotations

import numpy as np

_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def thickened_hull(points: np.ndarray, width_mm: float) -> np.ndarray:
    """Convex hull of points [mm], counter-clockwise, at least ``width_mm`` wide."""
    from scipy.spatial import ConvexHull

    # A hair's width, so that points on one line have a hull too.
    points = (np.unique(np.round(points, 6), axis=0)[:, None] + 1e-6 * _SQUARE).reshape(-1, 2)
    hull = ConvexHull(points)
    across = hull.equations[:, :2] @ points.T
    short = 0.5 * (width_mm - float(np.ptp(across, axis=1).min()))
    if short > 0:
        points = (points[:, None] + short * _SQUARE).reshape(-1, 2)
        hull = ConvexHull(points)
    return without_short_sides(points[hull.vertices])


def without_short_sides(polygon: np.ndarray) -> np.ndarray:
    """Drops corners that lie within 1e-4 of the one before."""
    length = np.linalg.norm(polygon - np.roll(polygon, 1, axis=0), axis=1)
    return polygon[length > 1e-4]


def clipped(polygon: np.ndarray, places: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """What of a convex polygon lies on the inner side of all lines through places with outward
    normals, each [n, 2] (Sutherland and Hodgman 1974)."""
    for place, normal in zip(places, normals, strict=True):
        outside = (polygon - place) @ normal
        if not (outside > 0).any():
            continue
        kept: list[np.ndarray] = []
        for i in range(len(polygon)):
            j = (i + 1) % len(polygon)
            if outside[i] <= 0:
                kept.append(polygon[i])
            if (outside[i] <= 0) != (outside[j] <= 0):
                part = outside[i] / (outside[i] - outside[j])
                kept.append(polygon[i] + part * (polygon[j] - polygon[i]))
        polygon = np.array(kept).reshape(-1, 2)
    return polygon


def centroid(polygon: np.ndarray) -> np.ndarray:
    """Centre of its area, [2]."""
    following = np.roll(polygon, -1, axis=0)
    area = polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]
    return ((polygon + following) * area[:, None]).sum(axis=0) / (3 * area.sum())


def second_moments(outline: np.ndarray) -> np.ndarray:
    """Mean of x x^T over the inside of a polygon, [2, 2]."""
    following = np.roll(outline, -1, axis=0)
    area = outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]
    both = outline + following
    moments = sum(np.einsum("n,ni,nj->ij", area, p, p) for p in (outline, following, both))
    return moments / (12 * area.sum())


def side_normals(outline: np.ndarray) -> np.ndarray:
    """Unit normals outwards of the sides from each corner to the next, [n, 2]."""
    along = np.roll(outline, -1, axis=0) - outline
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def where_rays_leave(
    outline: np.ndarray, rays: np.ndarray, starts: np.ndarray | None = None
) -> np.ndarray:
    """Where rays, [n, 2], from points inside a convex polygon (the origin) leave it."""
    starts = np.zeros_like(rays) if starts is None else starts
    normal = side_normals(outline)
    speed = rays @ normal.T
    left = ((outline - starts[:, None]) * normal).sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(speed > 0, left / speed, np.inf)
    return starts + rays * reach.min(axis=1)[:, None]
