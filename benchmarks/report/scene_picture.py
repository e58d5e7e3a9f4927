# SPDX-License-Identifier: Apache-2.0
"""The picture of the scenes, in the middle of their motions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from taccel_lab.benchmarks.report.plots import save
from taccel_lab.benchmarks.runner import Runner
from taccel_lab.benchmarks.scenes import build_scene
from taccel_lab.bodies.primitives import sphere_mesh
from taccel_lab.model import BodyKind
from taccel_lab.scene import Ball

MOMENTS = {
    "peg": (160, (1.3, -1.0, 0.6)),
    "press_5215": (20, (0.5, -1.0, 0.55)),
    "bolt": (40, (1.0, -1.2, 0.5)),
    "hand": (14, (1.0, 0.9, 0.5)),
    "squeeze": (36, (1.0, -0.55, 0.3)),
}
"""Step, and direction that it is looked at from."""
COLORS = {
    BodyKind.SOFT: "#7fb2d9",
    BodyKind.AFFINE: "#e0a458",
    BodyKind.KINEMATIC: "#b8b8b8",
}


def draw_scenes(path: Path) -> Path:
    """Run each scene to its moment, render it, and put the pictures side by side."""
    figure, axes = plt.subplots(1, len(MOMENTS), figsize=(15, 3.6), layout="constrained")
    for axis, (name, (step, direction)) in zip(axes, MOMENTS.items(), strict=True):
        runner = Runner(build_scene(name))
        runner.run(step)
        axis.imshow(render(runner, direction))
        axis.set_title(f"{name}, step {step}", fontsize=10)
        axis.axis("off")
    return save(figure, path)


def render(runner: Runner, direction: tuple[float, float, float]) -> np.ndarray:
    """The surfaces of all bodies, seen from a direction; pixels [height, width, 3]."""
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, window_size=[520, 520])
    for kind, vertices, faces in surfaces(runner):
        cells = np.column_stack([np.full(len(faces), 3), faces])
        plotter.add_mesh(
            pyvista.PolyData(1e3 * vertices, cells),
            color=COLORS[kind],
            show_edges=kind is BodyKind.SOFT,
            edge_color="#3b5a75",
            line_width=0.6,
            opacity=0.35 if kind is BodyKind.KINEMATIC else 1.0,
        )
    plotter.view_vector(direction, viewup=(0, 0, 1))  # type: ignore[arg-type]
    plotter.camera.zoom(1.15)
    picture = plotter.screenshot(return_img=True)
    plotter.close()
    return np.asarray(picture)


def surfaces(runner: Runner) -> list[tuple[Any, np.ndarray, np.ndarray]]:
    """Kind, vertices [m] and triangles of every body that has a surface."""
    model, found = runner.model, []
    positions = runner.state.positions.numpy()[0]
    bodies = [b for b in runner.bench.scene.bodies if hasattr(b, "surface")]
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
