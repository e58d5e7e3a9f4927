# SPDX-License-Identifier: Apache-2.0
"""The bodies of a scene as pixels: gels blue, free bodies orange, what is moved grey and clear."""

from __future__ import annotations

import numpy as np

from taccel_lab.model import BodyKind, Model
from taccel_lab.tasks.bodies import surfaces

BODY_COLORS = {BodyKind.SOFT: "#7fb2d9", BodyKind.AFFINE: "#e0a458", BodyKind.KINEMATIC: "#b8b8b8"}
CLEAR = 0.35
"""Opacity of what is moved: holes and fingers hide what happens in them."""


def draw_bodies(
    model: Model,
    positions: np.ndarray,
    direction: tuple[float, float, float],
    size_px: tuple[int, int] = (520, 520),
) -> np.ndarray:
    """Draw the surfaces of all bodies of one environment.

    Args:
        model: Of the scene.
        positions: Of its nodes [m], [node_count, 3].
        direction: Where it is looked at from, in world axes.
        size_px: Width and height.

    Returns:
        RGB, uint8, [height, width, 3].
    """
    import pyvista

    # Without a display VTK warns that there is none, and draws in memory.
    with pyvista.vtk_verbosity("error"):
        plotter = pyvista.Plotter(off_screen=True, window_size=list(size_px))
        for kind, vertices, faces in surfaces(model.scene, model, positions):
            plotter.add_mesh(
                pyvista.PolyData.from_regular_faces(1e3 * vertices, faces),
                color=BODY_COLORS[kind],
                show_edges=kind is BodyKind.SOFT,
                edge_color="#3b5a75",
                line_width=0.6,
                opacity=CLEAR if kind is BodyKind.KINEMATIC else 1.0,
            )
        plotter.view_vector(direction, viewup=(0, 0, 1))  # type: ignore[arg-type]
        plotter.camera.zoom(1.05)
        picture = np.asarray(plotter.screenshot(return_img=True))
        plotter.close()
    return picture
