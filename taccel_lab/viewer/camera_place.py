# SPDX-License-Identifier: Apache-2.0
"""Where a page looks from at first, and the light that it has."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.viewer.arrows import round_length

if TYPE_CHECKING:
    from viser import ViserServer

DIRECTION = (0.35, -1.0, 0.75)
"""Direction from which a gel is seen: from the front, right and above; z is up."""


def add_axes(server: ViserServer, corner_mm: np.ndarray, length_mm: float) -> None:
    """The axes of the gel frame at a corner, each ``length_mm`` long, with their names."""
    colors = ((213, 60, 50), (0, 158, 115), (0, 114, 178))
    for axis, (name, color) in enumerate(zip("xyz", colors, strict=True)):
        end = corner_mm + length_mm * np.eye(3)[axis]
        server.scene.add_arrows(
            f"/axes/{name}", np.stack([corner_mm, end])[None], color,
            shaft_radius=0.03 * length_mm, head_radius=0.08 * length_mm,
            head_length=0.2 * length_mm,
        )  # fmt: skip
        text = f"{name}, {length_mm:g} mm" if name == "x" else name
        server.scene.add_label(f"/axes/{name}/label", text, position=tuple(end))


def look_at(
    server: ViserServer,
    points_mm: np.ndarray,
    direction: tuple[float, float, float] = DIRECTION,
    distance: float = 1.6,
) -> None:
    """Point the view of a page at the middle of points [n, 3], ``distance`` times their extent
    away."""
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    toward = np.asarray(direction) / np.linalg.norm(direction)
    scene = server.scene
    scene.set_up_direction("+z")
    scene.configure_default_lights(cast_shadow=False)
    server.gui.main_panel.dock_right()
    # Above the far left corner, where nothing hides them and no panel is.
    corner = np.array([low[0], high[1], high[2] + 0.04 * size])
    add_axes(server, corner, round_length(0.15 * size))
    camera = server.initial_camera
    camera.position = middle + distance * size * toward
    camera.look_at = middle
    camera.fov = float(np.radians(38))
    for client in server.get_clients().values():
        client.camera.position = tuple(camera.position)
        client.camera.look_at = tuple(middle)
