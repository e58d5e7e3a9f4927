# SPDX-License-Identifier: Apache-2.0
"""Maps that turn the camera's raw image into one with the same scale everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial import Delaunay

from calibration.camera.intrinsics import Intrinsics
from calibration.camera.on_gel import OnGel
from taccel_lab.geometry import PixelGrid
from taccel_lab.output import atomic_file

_CHUNK_PX = 100_000
_BEYOND_PITCHES = 1.0


@dataclass(frozen=True)
class RectificationMaps:
    """For each pixel of the rectified image, where to look in the raw one (``cv2.remap``)."""

    map_u_px: np.ndarray
    """float32, shape [height_px, width_px]; negative where the raw image shows nothing."""
    map_v_px: np.ndarray
    measured: np.ndarray
    """Pixels under the board or within a pitch of it, bool; the map is extrapolated elsewhere."""
    grid: PixelGrid | None
    """Pixels of the rectified image on the gel; None where the scale is not known."""

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The rectified image; black where the raw one shows nothing."""
        return cv2.remap(image, self.map_u_px, self.map_v_px, cv2.INTER_LINEAR)

    def save(self, path: Path | str) -> None:
        """Write an npz: map_u_px, map_v_px, measured, and the grid's scale and middle."""
        about: dict[str, Any] = {}
        if self.grid is not None:
            about = {
                "mm_per_px": np.array([self.grid.mm_per_px_x, self.grid.mm_per_px_y]),
                "center_px": np.array([self.grid.center_u_px, self.grid.center_v_px]),
            }
        with atomic_file(path) as staging, staging.open("wb") as stream:
            np.savez_compressed(
                stream,
                map_u_px=self.map_u_px,
                map_v_px=self.map_v_px,
                measured=self.measured,
                **about,
            )


def gel_maps(on_gel: OnGel) -> RectificationMaps:
    """Maps to the pixel grid on the gel's face."""
    grid = on_gel.grid
    x, y = np.meshgrid(grid.x_mm(), grid.y_mm())
    xy = np.column_stack([x.ravel(), y.ravel()])
    uv = np.concatenate(
        [on_gel.pixel_from_gel(xy[k : k + _CHUNK_PX]) for k in range(0, len(xy), _CHUNK_PX)]
    )
    uv = np.where(np.isfinite(uv), uv, -1e4)
    points = on_gel.points_in_gel_mm
    pitch = float(on_gel.views[0].pitch_mm or 1.0)
    middle = points.mean(axis=0)
    away = points - middle
    length = np.linalg.norm(away, axis=1, keepdims=True)
    grown = middle + away * (1 + _BEYOND_PITCHES * pitch / np.maximum(length, pitch))
    measured = np.asarray(Delaunay(grown).find_simplex(xy), dtype=np.int64) >= 0
    shape = (grid.height_px, grid.width_px)
    return RectificationMaps(
        uv[:, 0].reshape(shape).astype(np.float32),
        uv[:, 1].reshape(shape).astype(np.float32),
        np.reshape(measured, shape),
        grid,
    )


def lens_maps(intrinsics: Intrinsics) -> RectificationMaps:
    """Maps that remove the lens's distortion alone, at the same focal length."""
    lens, parameters = intrinsics.lens, intrinsics.parameters
    fx, fy, cx, cy = parameters[:4]
    width, height = intrinsics.size_px
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.column_stack([(u.ravel() - cx) / fx, (v.ravel() - cy) / fy, np.ones(u.size)])
    uv = lens.project(rays, parameters, np.zeros(6))
    inside = np.all((uv >= -1) & (uv <= (width, height)), axis=1)
    uv[~inside] = -1e4
    shape = (height, width)
    return RectificationMaps(
        uv[:, 0].reshape(shape).astype(np.float32),
        uv[:, 1].reshape(shape).astype(np.float32),
        np.reshape(inside, shape),
        None,
    )
