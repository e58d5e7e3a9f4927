# SPDX-License-Identifier: Apache-2.0
"""A map of heights as a surface in space: its points, its triangles, and a PLY file of both."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.files.atomic_file import write_bytes
from taccel_lab.geometry.pixel_grid import PixelGrid
from taccel_lab.guards import require_shape

_VERTEX = np.dtype([("point", "<f4", 3), ("normal", "<f4", 3)])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
_HEADER = """ply
format binary_little_endian 1.0
comment Surface of a gel in the gel frame, metres, by taccel-lab
element vertex {vertices}
property float x
property float y
property float z
property float nx
property float ny
property float nz
element face {faces}
property list uchar int vertex_indices
end_header
"""


def points_of_heights(height_m: np.ndarray, grid: PixelGrid) -> np.ndarray:
    """Points of a height map [m] in the gel frame, [height_px, width_px, 3], NaN where it is."""
    require_shape("heights", height_m, (grid.height_px, grid.width_px), finite=False)
    x, y = np.meshgrid(1e-3 * grid.x_mm(), 1e-3 * grid.y_mm())
    missing = np.where(np.isfinite(height_m), 0.0, np.nan)
    return np.stack([x + missing, y + missing, height_m], axis=-1)


def triangles_of_pixels(known: np.ndarray) -> np.ndarray:
    """Triangles between neighbours that are ``known``, bool, [height_px, width_px].

    Returns:
        Pixels counted along rows, int64, [triangle, 3]; they turn around the outward normal.
    """
    number = np.arange(known.size).reshape(known.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    halves = np.stack([np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)], axis=-2)
    faces = halves.reshape(-1, 3)
    return faces[known.ravel()[faces].all(axis=1)]


def write_ply(path: Path | str, points_m: np.ndarray, normals: np.ndarray) -> None:
    """Write a surface as binary PLY: vertices in metres with their normals, and triangles.

    Args:
        path: The file; one that is there is replaced.
        points_m: Points by pixel, [height_px, width_px, 3]; NaN where there is no surface.
        normals: Outward unit normals, likewise.
    """
    known = np.asarray(np.isfinite(points_m + normals).all(axis=-1))
    rank = np.cumsum(known.ravel()) - 1
    faces = rank[triangles_of_pixels(known)]
    vertices = np.zeros(int(known.sum()), dtype=_VERTEX)
    vertices["point"], vertices["normal"] = points_m[known], normals[known]
    triangles = np.zeros(len(faces), dtype=_FACE)
    triangles["count"], triangles["corners"] = 3, faces
    header = _HEADER.format(vertices=len(vertices), faces=len(faces)).encode()
    write_bytes(path, header + vertices.tobytes() + triangles.tobytes())
