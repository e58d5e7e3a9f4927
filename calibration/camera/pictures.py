# SPDX-License-Identifier: Apache-2.0
"""Pictures of a calibrated camera: points found, what the fit leaves, distortion, rectification."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.camera.board_on_gel import OnGel
from taccel_lab.calibration.camera.intrinsics import Intrinsics
from taccel_lab.calibration.camera.rectification import RectificationMaps
from taccel_lab.calibration.report.image_axes import frame_image, round_enlargement
from taccel_lab.calibration.robust_fit import rms
from taccel_lab.report.style import BLUE, GREY, LIGHT, ORANGE, in_report_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GRID_LINES = 13


def _plain_number(value: float, _position: int) -> str:
    return f"{value:.3g}"


def _arrow_scale(residuals: np.ndarray, size_px: tuple[int, int]) -> float:
    """Enlargement that makes arrows legible."""
    return round_enlargement(0.03 * max(size_px) / max(rms(residuals), 1e-9))


@in_report_style
def draw_views(found: Intrinsics) -> Figure:
    """All points of all views, and the held-out error of each view by lens."""
    figure, (left, right) = new_figure(9.5, 3.8, 1, 2)
    for view in found.views:
        left.plot(view.uv_px[:, 0], view.uv_px[:, 1], ".", ms=2, color=BLUE, alpha=0.6)
    frame_image(left, found.size_px)
    left.set_title(f"{len(found.views)} views, {found.coverage:.0%} of the image")
    names = [score.lens.name for score in found.scores]
    data = [np.sqrt(score.view_mse) for score in found.scores]
    for k, values in enumerate(data):
        chosen = names[k] == found.lens.name
        spread = np.linspace(-0.15, 0.15, len(values)) if len(values) > 1 else [0.0]
        right.plot(k + np.asarray(spread), values, "o", ms=3, color=BLUE if chosen else GREY)
        right.plot([k - 0.3, k + 0.3], [np.sqrt(np.mean(values**2))] * 2, "-", color=ORANGE)
    right.set_xticks(range(len(names)), names)
    right.set_ylabel("held-out error of a view [px]")
    right.set_yscale("log")
    right.yaxis.set_major_formatter(_plain_number)
    right.yaxis.set_minor_formatter(_plain_number)
    right.grid(True, axis="y")
    right.set_title(f"chosen: {found.lens.name}")
    return figure


@in_report_style
def draw_residuals(found: Intrinsics) -> Figure:
    """What the fit leaves at every point, enlarged."""
    figure, axes = new_figure(6.5, 5.0)
    residuals = np.concatenate(found.chosen.fit.residuals)
    points = np.concatenate([view.uv_px for view in found.views])
    scale = _arrow_scale(residuals, found.size_px)
    axes.quiver(
        points[:, 0], points[:, 1], residuals[:, 0] * scale, residuals[:, 1] * scale,
        angles="xy", scale_units="xy", scale=1, width=0.0018, color=BLUE,
    )  # fmt: skip
    frame_image(axes, found.size_px)
    axes.set_title(f"seen minus projected, {scale:g} times enlarged; {rms(residuals):.2f} px rms")
    return figure


@in_report_style
def draw_on_gel(found: OnGel, image: np.ndarray) -> Figure:
    """Points of the board on the gel with what the fit leaves, and the pixel grid on the gel."""
    figure, axes = new_figure(6.5, 5.0)
    view = found.views[0]
    axes.imshow(image, alpha=0.75)
    points = found.points_in_gel_mm
    low, high = points.min(axis=0), points.max(axis=0)
    for k in range(_GRID_LINES):
        t = np.linspace(0, 1, 60)
        share = k / (_GRID_LINES - 1)
        for line in (
            np.column_stack([np.full(60, low[0] + share * (high[0] - low[0])),
                             low[1] + t * (high[1] - low[1])]),
            np.column_stack([low[0] + t * (high[0] - low[0]),
                             np.full(60, low[1] + share * (high[1] - low[1]))]),
        ):  # fmt: skip
            uv = found.pixel_from_gel(line)
            axes.plot(uv[:, 0], uv[:, 1], "-", lw=0.6, color=LIGHT)
    residual = found.fit.residuals[0]
    scale = _arrow_scale(residual, view.size_px)
    axes.plot(view.uv_px[:, 0], view.uv_px[:, 1], "o", ms=4, mfc="none", color=BLUE)
    axes.quiver(
        view.uv_px[:, 0], view.uv_px[:, 1], residual[:, 0] * scale, residual[:, 1] * scale,
        angles="xy", scale_units="xy", scale=1, width=0.003, color=ORANGE,
    )  # fmt: skip
    axes.plot(*found.center_px, "+", ms=14, mew=2, color=ORANGE)
    frame_image(axes, view.size_px)
    axes.set_title(
        f"{len(view.index)} of {view.expected} points; residuals {scale:g} times enlarged"
    )
    return figure


@in_report_style
def draw_rectified(maps: RectificationMaps, image: np.ndarray) -> Figure:
    """The image before and after."""
    figure, (left, right) = new_figure(9.5, 3.9, 1, 2)
    height, width = maps.map_u_px.shape
    left.imshow(image)
    frame_image(left, (image.shape[1], image.shape[0]))
    left.set_title("as recorded")
    after = maps.apply(image)
    grid = maps.grid
    if grid is None:
        right.imshow(after)
        frame_image(right, (width, height))
    else:
        x, y = grid.x_mm(), grid.y_mm()
        dimmed = np.where(maps.measured[..., None], after, (after * 0.45).astype(after.dtype))
        right.imshow(dimmed, extent=(x[0], x[-1], y[-1], y[0]))
        right.set_xlabel("x [mm]")
        right.set_ylabel("y [mm]")
    right.set_title("rectified; dimmed where the map is extrapolated" if grid else "rectified")
    return figure
