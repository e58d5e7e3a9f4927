# SPDX-License-Identifier: Apache-2.0
"""The surface that a live sensor reads, in space: coloured by depth, in the light of the page."""

from __future__ import annotations

import math
import threading
from collections import Counter
from functools import cache
from typing import TYPE_CHECKING

import cv2
import numpy as np

from taccel_lab.geometry.height_surface import triangles_of_pixels
from taccel_lab.reading.reading import Reading
from taccel_lab.report.painted_mesh import painted_mesh

if TYPE_CHECKING:
    from viser import GlbHandle, ViserServer

MOST_POINTS = 20_000
"""Points of one sensor at most; a frame of them is 1 MB."""
LOADED_S = 0.15
"""Time in which a page has loaded a surface: the one before is hidden then."""
DIRECTION = np.array((0.25, -0.8, 0.9))
"""Direction from which surfaces are seen at first."""
PALE = 0.25
"""Share of white: slopes of an untouched gel, which is dark, are to be seen."""
REJECTED = (150, 150, 150)
"""Colour of a surface that is not to be believed."""


class SurfaceView:
    """Surfaces of the sensors of a page, side by side; lengths are shown in mm."""

    def __init__(self, server: ViserServer) -> None:
        self._server = server
        self._shown: dict[str, Reading] = {}
        self._frames: Counter[str] = Counter()
        self._handles: dict[tuple[str, int], GlbHandle] = {}

    def hide(self) -> bool:
        """Take all surfaces off the page; whether there were any."""
        if not self._shown:
            return False
        self._server.scene.remove_by_name("/live")
        self._shown.clear()
        self._handles.clear()
        return True

    def show(self, name: str, found: Reading | None, *, relief: float, least_mm: float) -> float:
        """Show a sensor's surface, of a new sensor beside those that are there.

        Args:
            name: Of the sensor; empty where it is the only one.
            found: What it reads; the last surface stays in grey where that is None.
            relief: Times by which heights are drawn.
            least_mm: End of the colour scale where no sensor is pressed deeper.

        Returns:
            The end of the colour scale [mm].
        """
        rejected, first = found is None, name not in self._shown
        if found is None:
            if first:
                return least_mm
            found = self._shown[name]
        if not self._shown:
            self._server.scene.set_background_image(None)
        self._shown[name] = found
        deepest_mm = max(least_mm, *(f.depth_mm for f in self._shown.values()))
        at_mm = self._place_mm(name)
        points_mm, shown = surface_mesh(found, relief, deepest_mm, at_mm, rejected=rejected)
        with self._server.atomic():
            # A page takes a moment to load one: the last stays so long.
            self._frames[name] += 1
            self._handles[name, self._frames[name] % 2] = self._server.scene.add_glb(
                f"/live/{name or 'gel'}/{self._frames[name] % 2}",
                shown,
                cast_shadow=False,
                receive_shadow=False,
            )
            if first and name:
                low = points_mm.min(axis=0)
                self._server.scene.add_label(
                    f"/live/{name}/label", name, position=tuple(low - (0, 1, 0))
                )
        if first:
            self._look()
        settled = threading.Timer(LOADED_S, self._hide_last, (name, self._frames[name]))
        settled.daemon = True
        settled.start()
        return deepest_mm

    def _hide_last(self, name: str, frame: int) -> None:
        """Hide the surface before ``frame``, unless another has taken its place."""
        last = self._handles.get((name, 1 - frame % 2))
        if last is not None and self._frames[name] == frame:
            last.visible = False

    def _place_mm(self, name: str) -> float:
        """Where the middle of a sensor lies along x, in the order of the names."""
        left = 0.0
        for other in sorted(self._shown):
            grid = self._shown[other].grid
            wide_mm = grid.width_px * grid.mm_per_px_x
            if other == name:
                return left + wide_mm / 2
            left += 1.15 * wide_mm
        return left

    def _look(self) -> None:
        """Point all windows at the surfaces."""
        grids = [found.grid for found in self._shown.values()]
        wide_mm = sum(1.15 * grid.width_px * grid.mm_per_px_x for grid in grids)
        high_mm = max(grid.height_px * grid.mm_per_px_y for grid in grids)
        middle = np.array((wide_mm / 2.3, 0.0, 0.0))
        away_mm = 1.5 * math.hypot(wide_mm, high_mm)
        scene, camera = self._server.scene, self._server.initial_camera
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)
        camera.position = middle + away_mm * DIRECTION / np.linalg.norm(DIRECTION)
        camera.look_at, camera.fov = middle, math.radians(38)
        for client in self._server.get_clients().values():
            # A window higher than wide shows as much of the width from further away.
            further = 1.0 / min(client.camera.aspect or 1.0, 1.0)
            client.camera.position = middle + further * (np.asarray(camera.position) - middle)
            client.camera.look_at = middle


def surface_mesh(
    found: Reading,
    relief: float,
    deepest_mm: float,
    at_mm: float = 0.0,
    *,
    rejected: bool = False,
) -> tuple[np.ndarray, bytes]:
    """Points of a surface [mm], [n, 3], and the surface as binary glTF: brightest at
    ``deepest_mm``, moved by ``at_mm`` along x. Other arguments as of ``SurfaceView.show``."""
    part = np.s_[:: _every(found), :: _every(found)]
    points_mm = found.points_mm[part]
    points_mm[..., 2] *= relief
    points_mm[..., 0] += at_mm
    normals = found.normals[part] * (relief, relief, 1.0)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    share = np.clip(1e3 * found.depth_m[part] / deepest_mm, 0.0, 1.0)
    faces = triangles_of_pixels(np.ones(share.shape, dtype=bool))
    flat = points_mm.reshape(-1, 3)
    colors = np.full((2, 3), REJECTED, np.uint8) if rejected else _pale_map()
    return flat, painted_mesh(flat, faces, share.ravel(), colors, normals.reshape(-1, 3))


@cache
def _pale_map() -> np.ndarray:
    """The colour map of depths, uint8, [256, 3]."""
    steps = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)
    colors = cv2.cvtColor(steps, cv2.COLOR_BGR2RGB)[:, 0]
    return np.round(PALE * 255 + (1 - PALE) * colors).astype(np.uint8)


def _every(found: Reading) -> int:
    """Rows and columns of which one is shown."""
    return max(1, math.ceil(math.sqrt(found.depth_m.size / MOST_POINTS)))
