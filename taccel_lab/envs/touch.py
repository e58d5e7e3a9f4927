# SPDX-License-Identifier: Apache-2.0
"""Where an indenter that comes straight down first touches a surface at rest."""

from __future__ import annotations

import numpy as np

from taccel_lab.scene import Ball, TriangleMesh

_SUBDIVISIONS = 6
_CHUNK = 512


def first_touch_m(
    shape: Ball | TriangleMesh, positions: np.ndarray, faces: np.ndarray, at_m: np.ndarray
) -> float:
    """Height of the indenter's origin [m] at first touch, -inf when it passes beside the surface.

    ``positions`` [node, 3] and ``faces`` [face, 3] are the contact face, ``at_m`` [2] the xy of
    the indenter's origin. Faces are sampled ``_SUBDIVISIONS`` to an edge: for a ball of radius R
    and edges of length h the error is below h^2 / (8 R _SUBDIVISIONS^2).
    """
    reach = _reach(shape)
    corners = positions[faces]
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    near = ((low <= at_m + reach) & (high >= at_m - reach)).all(axis=1)
    if not near.any():
        return -np.inf
    weights = _barycentric_grid(_SUBDIVISIONS)
    samples = np.einsum("sw,fwi->fsi", weights, corners[near]).reshape(-1, 3)
    offset = samples[:, :2] - at_m
    if isinstance(shape, Ball):
        below_sq = shape.radius_m**2 - (offset**2).sum(axis=1)
        hit = below_sq > 0
        heights = samples[hit, 2] + np.sqrt(below_sq[hit])
        return float(heights.max(initial=-np.inf))
    under = _height_over(offset, shape.vertices_m, shape.faces, lowest=True)
    down = samples[:, 2] - under
    over = _height_over(shape.vertices_m[:, :2] + at_m, positions, faces[near], lowest=False)
    up = over - shape.vertices_m[:, 2]
    both = np.concatenate([down, up])
    return float(both[np.isfinite(both)].max(initial=-np.inf))


def _reach(shape: Ball | TriangleMesh) -> float:
    if isinstance(shape, Ball):
        return shape.radius_m
    return float(np.abs(shape.vertices_m[:, :2]).max())


def _barycentric_grid(n: int) -> np.ndarray:
    """Barycentric coordinates of a regular grid over a triangle, shape [samples, 3]."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    keep = i + j <= n
    return np.stack([i[keep], j[keep], n - i[keep] - j[keep]], axis=1) / n


def _height_over(
    xy: np.ndarray, vertices: np.ndarray, faces: np.ndarray, *, lowest: bool
) -> np.ndarray:
    """Lowest or highest z of a surface on the vertical line through each xy; NaN for a miss."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    ab, ac = (b - a)[:, :2], (c - a)[:, :2]
    det = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    upright = np.abs(det) <= 1e-12 * (np.abs(ab).max() + 1e-30) ** 2
    det = np.where(upright, np.nan, det)
    result = np.full(len(xy), np.nan)
    for start in range(0, len(xy), _CHUNK):
        p = xy[start : start + _CHUNK, None] - a[None, :, :2]
        u = (p[..., 0] * ac[:, 1] - p[..., 1] * ac[:, 0]) / det
        v = (ab[:, 0] * p[..., 1] - ab[:, 1] * p[..., 0]) / det
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
        z = a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2]
        fill = np.inf if lowest else -np.inf
        z = np.where(inside, z, fill)
        best = z.min(axis=1) if lowest else z.max(axis=1)
        result[start : start + _CHUNK] = np.where(np.isfinite(best), best, np.nan)
    return result
