# SPDX-License-Identifier: Apache-2.0
"""The underside of a rigid object over the gel, as the fused tactile image needs it.

A surface answers three questions, all in the gel frame: how far a gel point is from it (``gap``),
the height and slope of the surface a given gap below it at the pixels (``offset_height``), and
where that surface can be followed at all (``seen``). The gap is whatever measure makes the second
the exact inverse of the first: the radial distance for a sphere, the vertical one for a height
field.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.shading_normals import corner_normals
from taccel_lab.signals.normals import slopes_from_height
from taccel_lab.signals.raster import FaceRaster

# Steepness at which the side of a ball begins to fade and has faded out: further up a pixel spans
# as much of it as an element of the gel does, and above the equator there is nothing to follow.
_SEEN_DEG = (68.0, 82.0)
# Of interpolated normals of an object's underside, whose z is below zero: slopes up to 87 degrees.
_LEAST_DOWN = 0.05


class RigidSurface(Protocol):
    """Underside of an object in the gel frame, one pose an environment."""

    def gap(self, points: np.ndarray) -> np.ndarray:
        """Gap of gel points [m], [env, n, 3] to [env, n]; NaN where nothing is above the point."""
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

    def seen(
        self, env: int, pixels: np.ndarray, gap: np.ndarray, gap_slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """How far that surface can be followed: 1, falling to 0 towards a steep silhouette.

        Args:
            env: Environment.
            pixels: Flat pixel indices, shape [n].
            gap: Gap at those pixels [m], shape [n].
            gap_slope: Its gradient over xy, shape [n, 2].

        Returns:
            Weight, shape [n], and its gradient over xy [1/m], shape [n, 2].
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
        return np.linalg.norm(points - self.center_m[:, None], axis=-1) - self.radius_m

    def offset_height(
        self, env: int, pixels: np.ndarray, gap: np.ndarray, gap_slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        center = self.center_m[min(env, len(self.center_m) - 1)]
        offset = self._offset(env, pixels)
        radius = self.radius_m + gap
        below2 = radius**2 - (offset**2).sum(axis=-1)
        # Above the equator of the offset sphere the lower envelope ends.
        below = np.sqrt(np.where(below2 > 0, below2, np.nan))
        slope = (offset - radius[:, None] * gap_slope) / below[:, None]
        return center[2] - below, slope

    def seen(
        self, env: int, pixels: np.ndarray, gap: np.ndarray, gap_slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        offset = self._offset(env, pixels)
        radius = (self.radius_m + gap)[:, None]
        sine2 = ((offset / radius) ** 2).sum(axis=-1)
        sine2_slope = 2.0 * (offset / radius**2 - sine2[:, None] * gap_slope / radius)
        full, none = (math.sin(math.radians(angle)) ** 2 for angle in _SEEN_DEG)
        t = np.clip((none - sine2) / (none - full), 0.0, 1.0)
        rate = -6.0 * t * (1.0 - t) / (none - full)
        return t * t * (3.0 - 2.0 * t), rate[:, None] * sine2_slope

    def _offset(self, env: int, pixels: np.ndarray) -> np.ndarray:
        """Gel xy of pixels from the centre [m], shape [n, 2]."""
        row, column = np.divmod(pixels, self._grid.width_px)
        xy = np.stack([self._grid.x_mm()[column], self._grid.y_mm()[row]], axis=-1) * 1e-3
        return xy - self.center_m[min(env, len(self.center_m) - 1), :2]


class HeightFieldSurface:
    """An object's underside sampled at the pixels; the gap is vertical."""

    def __init__(
        self, height_m: np.ndarray, grid: PixelGrid, slope: np.ndarray | None = None
    ) -> None:
        """
        Args:
            height_m: Lowest height of the object [m], shape [h, w] or [env, h, w], NaN beside it.
            grid: Pixels of the image.
            slope: dh/dx and dh/dy of it, shape [..., h, w, 2]; by pixel differences when None.
        """
        height_m = np.asarray(height_m, dtype=np.float64)
        self.height_m = height_m[None] if height_m.ndim == 2 else height_m
        slope = slopes_from_height(self.height_m, grid) if slope is None else slope
        self._slope = np.reshape(slope, (*self.height_m.shape, 2))
        self._grid = grid

    @classmethod
    def from_mesh(
        cls, vertices_m: np.ndarray, triangles: np.ndarray, grid: PixelGrid, *, device: str = "cpu"
    ) -> HeightFieldSurface:
        """Rasterise the underside of a closed triangle mesh with outward faces.

        Heights are those of the triangles, slopes those of the surface that they stand for
        (``corner_normals``): facets of a curved surface do not show, edges do.

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
        found = raster.face_at_pixel.numpy()
        slope = np.stack([
            _shaded_slope(shape, triangles, faces, grid)
            for shape, faces in zip(vertices, found, strict=True)
        ])  # fmt: skip
        # Of a tool that leans by a degree a pixel shows millimetres of a wall.
        walls = np.stack([_are_walls(shape, triangles) for shape in vertices])
        on_wall = np.take_along_axis(walls, np.maximum(found, 0).reshape(len(vertices), -1), axis=1)
        there = np.isfinite(height) & ~on_wall.reshape(height.shape)
        return cls(np.where(there, height, np.nan), grid, slope)

    def up_to(self, height_m: float) -> HeightFieldSurface:
        """The same without the parts that lie above ``height_m`` [m]: a flange far over it ends
        a tool as its silhouette does."""
        near = np.where(self.height_m <= height_m, self.height_m, np.nan)
        return HeightFieldSurface(near, self._grid, self._slope)

    def gap(self, points: np.ndarray) -> np.ndarray:
        return self._sample(points) - points[..., 2]

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

    def seen(
        self, env: int, pixels: np.ndarray, gap: np.ndarray, gap_slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        height = self.height_m[min(env, len(self.height_m) - 1)].ravel()[pixels]
        # A stamp's side is sharp: its surface ends where it ends.
        return np.isfinite(height).astype(np.float64), np.zeros((len(pixels), 2))


def _shaded_slope(
    vertices: np.ndarray, triangles: np.ndarray, face_at_pixel: np.ndarray, grid: PixelGrid
) -> np.ndarray:
    """dh/dx and dh/dy where ``face_at_pixel`` names a triangle, NaN elsewhere; [h, w, 2]."""
    slope = np.full((*face_at_pixel.shape, 2), np.nan)
    row, column = np.nonzero(face_at_pixel >= 0)
    face = face_at_pixel[row, column]
    xy = np.stack([grid.x_mm()[column], grid.y_mm()[row]], axis=-1) * 1e-3
    a, b, c = (vertices[np.asarray(triangles)[face, k], :2] for k in range(3))
    share = np.stack([_twice_area(xy, b, c), _twice_area(a, xy, c), _twice_area(a, b, xy)], axis=1)
    share /= share.sum(axis=1, keepdims=True)
    normal = np.einsum("nk,nki->ni", share, corner_normals(vertices, np.asarray(triangles))[face])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    slope[row, column] = -normal[:, :2] / np.minimum(normal[:, 2:], -_LEAST_DOWN)
    return slope


def _are_walls(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Triangles that are too steep to be followed, bool, [triangle]."""
    a, b, c = (vertices[np.asarray(triangles)[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    return np.abs(normal[:, 2]) < math.cos(math.radians(_SEEN_DEG[1])) * length


def _twice_area(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Twice the signed areas of triangles in the plane, each corner [n, 2]."""
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
