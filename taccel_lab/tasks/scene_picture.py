# SPDX-License-Identifier: Apache-2.0
"""The surfaces of a scene's bodies, drawn as they are."""

from __future__ import annotations

from typing import Any

import numpy as np

from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.model import BodyKind, Model
from taccel_lab.scene import Ball, sphere_mesh

COLORS = {
    BodyKind.SOFT: "#7fb2d9",
    BodyKind.AFFINE: "#e0a458",
    BodyKind.KINEMATIC: "#b8b8b8",
}


def surfaces(
    scene: SceneDescription, model: Model, positions: np.ndarray
) -> list[tuple[Any, np.ndarray, np.ndarray]]:
    """Kind, vertices [m] and triangles of every body that has a surface, of one environment.

    ``positions``: of its nodes [m], [node_count, 3]. Planes are left out.
    """
    found = []
    bodies = [b for b in scene.bodies if hasattr(b, "surface")]
    for body, nodes in zip(bodies, model.bodies, strict=True):
        place = positions[nodes.node_slice]
        shape = getattr(body, "shape", None)
        if nodes.kind is BodyKind.SOFT:
            found.append((nodes.kind, place, body.nodal_mesh.faces))  # type: ignore[union-attr]
        elif isinstance(shape, Ball):
            ball = sphere_mesh(shape.radius_m, shape.radius_m / 10)
            found.append((nodes.kind, ball.vertices_m + place[0], ball.faces))
        elif shape is not None:
            found.append((nodes.kind, place, shape.faces))
    return found


class SceneCamera:
    """Draws bodies again and again from one place."""

    def __init__(
        self,
        bodies: list[tuple[Any, np.ndarray, np.ndarray]],
        direction: tuple[float, float, float],
        size_px: tuple[int, int] = (520, 520),
        box_m: np.ndarray | None = None,
        ground_m: float | None = None,
    ) -> None:
        """
        Args:
            bodies: Of ``surfaces``.
            direction: That it looks from, in world axes.
            size_px: Width and height of its pictures.
            box_m: What it has in view, lower and upper corner [2, 3]; the bodies when None.
            ground_m: Height of a ground that is drawn below them.
        """
        import pyvista

        self._plotter = pyvista.Plotter(off_screen=True, window_size=list(size_px))
        self._drawn = []
        for kind, vertices, faces in bodies:
            cells = np.column_stack([np.full(len(faces), 3), faces])
            surface = pyvista.PolyData(1e3 * vertices, cells)
            self._drawn.append(surface)
            self._plotter.add_mesh(
                surface,
                color=COLORS[kind],
                show_edges=kind is BodyKind.SOFT,
                edge_color="#3b5a75",
                line_width=0.6,
                opacity=0.35 if kind is BodyKind.KINEMATIC else 1.0,
            )
        self._plotter.view_vector(direction, viewup=(0, 0, 1))  # type: ignore[arg-type]
        if box_m is not None:
            low, high = 1e3 * box_m
            bounds = (low[0], high[0], low[1], high[1], low[2], high[2])
            self._plotter.reset_camera(bounds=bounds)  # type: ignore[call-arg, arg-type]
            if ground_m is not None:
                middle = (*((low + high) / 2)[:2], 1e3 * ground_m)
                side = 1.6 * float((high - low)[:2].max())
                ground = pyvista.Plane(center=middle, i_size=side, j_size=side)
                self._plotter.add_mesh(ground, color="#e8e4da", reset_camera=False)
        else:
            self._plotter.camera.zoom(1.15)

    def picture(self, bodies: list[tuple[Any, np.ndarray, np.ndarray]] | None = None) -> np.ndarray:
        """Pixels [height, width, 3], uint8, of the same bodies where they are now."""
        for surface, (_, vertices, _) in zip(self._drawn, bodies or (), strict=bodies is not None):
            surface.points = 1e3 * vertices
        self._plotter.render()
        return np.asarray(self._plotter.screenshot(return_img=True))

    def close(self) -> None:
        """Free the window."""
        self._plotter.close()
