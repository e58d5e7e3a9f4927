# SPDX-License-Identifier: Apache-2.0
"""The picture of the scenes, in the middle of their motions."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from taccel_lab.benchmarks.report.plots import save
from taccel_lab.benchmarks.runner import Runner
from taccel_lab.benchmarks.scenes import build_scene
from taccel_lab.tasks.scene_picture import SceneCamera, surfaces

MOMENTS = {
    "peg": (160, (1.3, -1.0, 0.6)),
    "press_5215": (20, (0.5, -1.0, 0.55)),
    "bolt": (40, (1.0, -1.2, 0.5)),
    "hand": (14, (1.0, 0.9, 0.5)),
    "squeeze": (36, (1.0, -0.55, 0.3)),
}
"""Step, and direction that it is looked at from."""


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
    positions = runner.state.positions.numpy()[0]
    camera = SceneCamera(surfaces(runner.bench.scene, runner.model, positions), direction)
    picture = camera.picture()
    camera.close()
    return picture
