# SPDX-License-Identifier: Apache-2.0
"""Pictures of dots whose pixels hold the exact area that the dots cover."""

from __future__ import annotations

import numpy as np


def disc_coverage(
    width_px: int, height_px: int, center_px: tuple[float, float], radius_px: float
) -> np.ndarray:
    """Share of each pixel that a disc covers, exact, shape [height_px, width_px].

    Pixel (0, 0) spans -0.5 to 0.5.
    """
    x = (np.arange(width_px + 1) - 0.5 - center_px[0]) / radius_px
    y = (np.arange(height_px + 1) - 0.5 - center_px[1]) / radius_px
    coverage = np.zeros((height_px, width_px))
    u0, u1 = np.searchsorted(x, [-1.0, 1.0]) + (-1, 0)
    v0, v1 = np.searchsorted(y, [-1.0, 1.0]) + (-1, 0)
    u0, v0 = max(u0, 0), max(v0, 0)
    corner = _area_below(x[None, u0 : u1 + 1], y[v0 : v1 + 1, None])
    part = np.diff(np.diff(corner, axis=0), axis=1) * radius_px**2
    coverage[v0 : v0 + part.shape[0], u0 : u0 + part.shape[1]] = np.clip(part, 0.0, 1.0)
    return coverage


def draw_dots(
    width_px: int,
    height_px: int,
    centers_px: np.ndarray,
    radius_px: float | np.ndarray,
    *,
    background: float | np.ndarray = 160.0,
    dot: float | np.ndarray = 25.0,
) -> np.ndarray:
    """Levels of a picture with dots, float64; ``background`` and ``dot`` are levels or pictures.

    Args:
        width_px: Columns.
        height_px: Rows.
        centers_px: Centres (u, v), shape [dot, 2].
        radius_px: Radius of all dots, or of each.
        background: Level beside the dots, a number or shape [height_px, width_px].
        dot: Level of the paint, likewise.
    """
    clear = np.ones((height_px, width_px))
    radii = np.broadcast_to(radius_px, len(centers_px))
    for (u, v), radius in zip(np.asarray(centers_px, dtype=float), radii, strict=True):
        if -radius - 1 < u < width_px + radius and -radius - 1 < v < height_px + radius:
            clear *= 1.0 - disc_coverage(width_px, height_px, (u, v), float(radius))
    return clear * background + (1.0 - clear) * dot


def _area_below(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Area of the part of the unit disc with X <= x and Y <= y."""
    x, y = np.clip(x, -1.0, 1.0), np.clip(y, -1.0, 1.0)
    edge = np.sqrt(1.0 - y * y)
    left, middle, right = np.minimum(x, -edge), np.clip(x, -edge, edge), np.maximum(x, edge)
    # Beyond the edge a chord lies wholly below y, or wholly above it.
    outer = np.where(y > 0, 2.0 * (_half(left) + _half(right) - _half(edge)), 0.0)
    return outer + y * (middle + edge) + _half(middle) - _half(-edge)


def _half(t: np.ndarray) -> np.ndarray:
    """Area of the upper half disc with X <= t."""
    t = np.clip(t, -1.0, 1.0)
    return 0.5 * (t * np.sqrt(1.0 - t * t) + np.arcsin(t) + 0.5 * np.pi)
