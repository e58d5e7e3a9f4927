# SPDX-License-Identifier: Apache-2.0
"""Pictures of dots whose pixels hold the exact area that the dots cover."""

from __future__ import annotations

import numpy as np

from tests.calibration.drawn.faults import add_noise, blur, quantise

WIDTH, HEIGHT = 320, 240
MARGIN = 40
"""Pictures are drawn wider by this much, so that their border is real."""


def disc_coverage(
    width_px: int, height_px: int, center_px: tuple[float, float], radius_px: float
) -> np.ndarray:
    """Share of each pixel that a disc covers, exact; pixel (0, 0) spans -0.5 to 0.5."""
    x = (np.arange(width_px + 1) - 0.5 - center_px[0]) / radius_px
    y = (np.arange(height_px + 1) - 0.5 - center_px[1]) / radius_px
    (u0, u1), (v0, v1) = (np.searchsorted(at, [-1.0, 1.0]) + (-1, 0) for at in (x, y))
    u0, v0 = max(u0, 0), max(v0, 0)
    corner = _area_below(x[None, u0 : u1 + 1], y[v0 : v1 + 1, None])
    part = np.diff(np.diff(corner, axis=0), axis=1) * radius_px**2
    coverage = np.zeros((height_px, width_px))
    coverage[v0 : v0 + part.shape[0], u0 : u0 + part.shape[1]] = np.clip(part, 0.0, 1.0)
    return coverage


def draw_dots(
    width_px: int,
    height_px: int,
    centers_px: np.ndarray,
    radius_px: float | np.ndarray,
    background: float | np.ndarray = 160.0,
    dot: float = 25.0,
) -> np.ndarray:
    """Levels of a picture with dots (u, v) [dot, 2] of one radius or of one each."""
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


def grid_points(
    rows: int = 7,
    columns: int = 9,
    pitch: tuple[float, float] = (30.0, 29.0),
    *,
    turn_rad: float = 0.0,
    centre: tuple[float, float] = (159.3, 119.8),
    stagger: float = 0.0,
) -> np.ndarray:
    """Centres row by row, shape [rows * columns, 2]."""
    row, column = np.mgrid[:rows, :columns].reshape(2, -1)
    x = (column + stagger * (row % 2) - (columns - 1) / 2) * pitch[0]
    y = (row - (rows - 1) / 2) * pitch[1]
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return np.stack([c * x - s * y, s * x + c * y], axis=1) + centre


def picture(
    centres: np.ndarray,
    radius: float | np.ndarray = 5.0,
    *,
    noise: float = 0.0,
    blur_px: float = 0.8,
    seed: int = 0,
    levels: bool = True,
    background: float | np.ndarray = 160.0,
    dot: float = 25.0,
) -> np.ndarray:
    """A grey picture of 320 x 240 px; ``levels`` rounds it to whole ones."""
    size = WIDTH + 2 * MARGIN, HEIGHT + 2 * MARGIN
    image = draw_dots(*size, np.asarray(centres) + MARGIN, radius, background, dot)
    if blur_px > 0:
        image = blur(image, blur_px)
    image = image[MARGIN:-MARGIN, MARGIN:-MARGIN]
    if noise > 0:
        image = add_noise(image, noise, np.random.default_rng(seed))
    return quantise(image) if levels else image


def nearest(found: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the nearest true point of each found one, and the way to it."""
    index = np.argmin(np.linalg.norm(found[:, None] - true[None], axis=2), axis=1)
    return index, found - true[index]
