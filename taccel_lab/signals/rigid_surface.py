# SPDX-License-Identifier: Apache-2.0
"""The underside of a rigid object over the gel, as the fused tactile image needs it.

A surface answers three questions, all in the gel frame: how far a gel point is from it
(``gap``), at which height over the same xy a point has another gap (``height_at_gap``), and the
same with its slope at the pixels (``offset_height``). The gap is whatever measure makes the others
its exact inverses: the radial distance for a sphere, the vertical one for a height field.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.normals import slopes_from_height
from taccel_lab.signals.raster import FaceRaster


class RigidSurface(Protocol):
    """Underside of an object in the gel frame, one pose an environment."""

    def gap(self, points: np.ndarray) -> np.ndarray:
        """Gap of gel points [m], [env, n, 3] to [env, n]; NaN where nothing is above the point."""
        ...

    def height_at_gap(self, points: np.ndarray, gap: np.ndarray) -> np.ndarray:
        """Height of the point over the same xy whose gap is ``gap`` [m], shape [env, n].

        NaN where there is no such point.
        """
        ...

    def offset_height(
        self, env: int, pixels: np.ndarray, gap: np.ndarray, gap_slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Height and slope of the surface at ``gap(x, y)`` below this one.

        Args:
            env: Environment.
            pixels: Flat pixel indices, shape [n].
            gap: Gap at those pixels [m], shape [n].
            gap_slope: Its gradient over xy, shape [n, 2].

        Returns:
            Height [m], shape [n], and slope, shape [n, 2]; NaN where the surface is not defined.
        """
        ...


class SphereSurface:
    """Lower half of a sphere; the gap is radial, so it stays regular at the equator."""

    def __init__(self, center_m: np.ndarray, radius_m: float, grid: PixelGrid) -> None:
        """
        Args:
            center_m: Centre in the gel frame [m], shape [3] or [env, 3].
            radius_m: Radius [m].
            grid: Pixels of the image.
        """
        self.center_m = np.atleast_2d(np.asarray(center_m, dtype=np.float64))
        if self.center_m.shape[1:] != (3,) or not np.isfinite(self.center_m).all():
            raise InputError(f"center_m must be finite, shape [env, 3], got {center_m}")
        if not (np.isfinite(radius_m) and radius_m > 0):
            raise InputError(f"radius_m must be a positive length in metres, got {radius_m}")
        self.radius_m = float(radius_m)
        self._grid = grid

    def gap(self, points: np.ndarray) -> np.ndarray:
        offset = points - self.center_m[:, None]
        gap = np.linalg.norm(offset, axis=-1) - self.radius_m
        return np.where(offset[..., 2] < 0, gap, np.nan)

    def height_at_gap(self, points: np.ndarray, gap: np.ndarray) -> np.ndarray:
        offset = points[..., :2] - self.center_m[:, None, :2]
        below2 = (self.radius_m + gap) ** 2 - (offset**2).sum(axis=-1)
        return self.center_m[:, None, 2] - np.sqrt(np.where(below2 > 0, below2, np.nan))

    def offset_height(
        self, env: int, pixels: np.ndarray, gap: np.ndarray, gap_slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        row, column = np.divmod(pixels, self._grid.width_px)
        center = self.center_m[min(env, len(self.center_m) - 1)]
        offset = np.stack(
            [self._grid.x_mm()[column] * 1e-3, self._grid.y_mm()[row] * 1e-3], axis=-1
        )
        offset -= center[:2]
        radius = self.radius_m + gap
        below2 = radius**2 - (offset**2).sum(axis=-1)
        # Above the equator of the offset sphere the lower envelope ends.
        below = np.sqrt(np.where(below2 > 0, below2, np.nan))
        slope = (offset - radius[:, None] * gap_slope) / below[:, None]
        return center[2] - below, slope


class HeightFieldSurface:
    """An object's underside sampled at the pixels; the gap is vertical."""

    def __init__(self, height_m: np.ndarray, grid: PixelGrid) -> None:
        """
        Args:
            height_m: Lowest height of the object [m], shape [h, w] or [env, h, w], NaN beside it.
            grid: Pixels of the image.
        """
        height_m = np.asarray(height_m, dtype=np.float64)
        self.height_m = height_m[None] if height_m.ndim == 2 else height_m
        self._slope = slopes_from_height(self.height_m, grid)
        self._grid = grid

    @classmethod
    def from_mesh(
        cls, vertices_m: np.ndarray, triangles: np.ndarray, grid: PixelGrid, *, device: str = "cpu"
    ) -> HeightFieldSurface:
        """Rasterise the underside of a closed triangle mesh with outward faces.

        Args:
            vertices_m: Vertices in the gel frame [m], shape [n, 3] or [env, n, 3].
            triangles: Outward triangles, shape [m, 3].
            grid: Pixels of the image.
            device: Warp device.
        """
        vertices = np.asarray(vertices_m, dtype=np.float64)
        vertices = vertices[None] if vertices.ndim == 2 else vertices
        if vertices.ndim != 3 or vertices.shape[2] != 3 or not np.isfinite(vertices).all():
            raise InputError(f"vertices_m must be finite, shape [env, n, 3], got {vertices.shape}")
        raster = FaceRaster(triangles, grid, faces_up=False, device=device)
        raster.update(wp.array(vertices, dtype=wp.vec3d, device=device))
        height = raster.lowest_z.numpy()
        return cls(np.where(np.isfinite(height), height, np.nan), grid)

    def gap(self, points: np.ndarray) -> np.ndarray:
        return self._sample(points) - points[..., 2]

    def height_at_gap(self, points: np.ndarray, gap: np.ndarray) -> np.ndarray:
        return self._sample(points) - gap

    def _sample(self, points: np.ndarray) -> np.ndarray:
        """Height at points, bilinear between pixels; NaN beside the image and on its rim."""
        uv = self._grid.pixel_from_gel(points[..., :2] * 1e3)
        limit = np.array([self._grid.width_px - 2, self._grid.height_px - 2])
        base = np.clip(np.floor(uv), 0, limit).astype(np.int64)
        fraction = uv - base
        inside = ((fraction >= 0) & (fraction <= 1)).all(axis=-1)
        env = np.arange(len(points))[:, None]
        column, row = base[..., 0], base[..., 1]
        s, t = fraction[..., 0], fraction[..., 1]
        upper = (1 - s) * self._at(env, row, column) + s * self._at(env, row, column + 1)
        lower = (1 - s) * self._at(env, row + 1, column) + s * self._at(env, row + 1, column + 1)
        return np.where(inside, (1 - t) * upper + t * lower, np.nan)

    def _at(self, env: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        return self.height_m[np.minimum(env, len(self.height_m) - 1), row, column]

    def offset_height(
        self, env: int, pixels: np.ndarray, gap: np.ndarray, gap_slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        env = min(env, len(self.height_m) - 1)
        height = self.height_m[env].ravel()[pixels] - gap
        return height, self._slope[env].reshape(-1, 2)[pixels] - gap_slope
