# SPDX-License-Identifier: Apache-2.0
"""A picture of a robot: what can be touched of it, and its gels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.files.atomic_file import write_image
from taccel_lab.robots.robot import Robot
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.scene import Ball, sphere_mesh

LINK_COLOR, GEL_COLOR = "#b8b8b8", "#7fb2d9"
SIZE_PX = (600, 600)


def draw_robot(
    robot: Robot,
    q: Any,
    path: Path,
    direction: tuple[float, float, float] = (1.0, -1.4, 0.6),
) -> None:
    """Draw shapes of links (grey) and gels at rest (blue) into a PNG file.

    Args:
        robot: Links without shape are not seen.
        q: Coordinates, [dof].
        path: The file.
        direction: Where it is looked at from, in world axes.

    Raises InputError for coordinates out of the limits, and shapes that cannot be made.
    """
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, window_size=list(SIZE_PX))
    frames = matrix_of(robot.targets(q))[0]
    gels = {gel.mount: gel for gel in robot.soft_bodies()}
    for body, frame in zip(robot.kinematic_bodies(), frames, strict=True):
        shape = body.shape
        if isinstance(shape, Ball):
            shape = sphere_mesh(shape.radius_m, shape.radius_m / 10)
        gel = gels.get(body.name)
        if gel is not None:
            points, faces = gel.mesh.nodes_m, gel.mesh.faces
        else:
            assert shape is not None  # Only frames of gels have none.
            points, faces = shape.vertices_m, shape.faces
        surface = pyvista.PolyData(
            1e3 * (points @ frame[:3, :3].T + frame[:3, 3]),
            np.column_stack([np.full(len(faces), 3), faces]),
        )
        color = LINK_COLOR if gel is None else GEL_COLOR
        plotter.add_mesh(
            surface, color=color, ambient=0.3, show_edges=gel is not None, edge_color="#3b5a75"
        )
        if gel is None:
            edges = surface.extract_feature_edges(feature_angle=30.0)
            if edges.n_points:  # A ball has none, and nothing cannot be drawn.
                plotter.add_mesh(edges, color="#555555", line_width=1.2)
    plotter.view_vector(direction, viewup=(0, 0, 1))  # type: ignore[arg-type]
    picture = np.asarray(plotter.screenshot(return_img=True))
    plotter.close()
    write_image(path, picture[..., ::-1])
