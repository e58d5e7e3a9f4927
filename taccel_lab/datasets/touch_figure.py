# SPDX-License-Identifier: Apache-2.0
"""One touch as a picture: what the sensor saw and felt over its steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.report.style import BLUE, ORANGE, in_report_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STRIP = 7
"""Most images of a touch."""


def picked(count: int) -> np.ndarray:
    """Steps of ``count`` that are shown, evenly, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, STRIP).round().astype(int))


@in_report_style
def draw_touch(
    steps: Mapping[str, np.ndarray], images: np.ndarray | None, depth_mm: np.ndarray | None
) -> Figure:
    """Images above depth maps, dark for nothing, and forces with the band of their error.

    Args:
        steps: Columns of the touch's steps, each [step].
        images: RGB at the ``picked`` steps, [k, H, W, 3]; None where the data set has none.
        depth_mm: How far the face sank there [mm], [k, H, W]; None likewise.
    """
    figure, axes = new_figure(13, 3.1, 2, STRIP + 2)
    grid = axes[0, 0].get_gridspec()
    for axis in axes.ravel():
        axis.set_axis_off()
    for column, k in enumerate(picked(len(steps["step"])).tolist()):
        depth = float(steps["depth_mm"][k])
        if images is not None:
            axes[0, column].imshow(images[column])
        axes[0, column].set_title(
            f"{depth:.2f} mm\n{steps['press_force_z_n'][k]:.2f} N", fontsize=8
        )
        if depth_mm is not None:
            axes[1, column].imshow(depth_mm[column], vmin=0, vmax=max(depth, 0.05))
    for axis in axes[:, STRIP:].ravel():
        axis.remove()
    _draw_forces(figure.add_subplot(grid[:, STRIP:]), steps)
    return figure


def tangential_n(steps: Mapping[str, np.ndarray]) -> np.ndarray:
    """Tangential force [N], [step]."""
    return np.hypot(steps["press_force_x_n"], steps["press_force_y_n"])


def _draw_forces(axes: Any, steps: Mapping[str, np.ndarray]) -> None:
    number, normal = steps["step"], steps["press_force_z_n"]
    error = steps["force_error_n"]
    axes.plot(number, normal, color=BLUE, marker=".", label="normal")
    axes.fill_between(number, normal - error, normal + error, color=BLUE, alpha=0.2, linewidth=0)
    axes.plot(number, tangential_n(steps), color=ORANGE, marker=".", label="tangential")
    axes.set_xlabel("step")
    axes.set_ylabel("force [N]")
    axes.set_ylim(top=1.3 * axes.get_ylim()[1])
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.legend(loc="upper center", ncols=2)
