# SPDX-License-Identifier: Apache-2.0
"""Figures of a calibration of normals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.color.evaluate import crop_slices
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.normals.samples import CaptureScene
from taccel_lab.calibration.normals.score import HeldoutNormals, ball_depth_mm
from taccel_lab.geometry import PixelGrid
from taccel_lab.report.style import BLUE, LIGHT, ORANGE, in_report_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

ROWS = 3
"""Presses that are shown: the worst, the middle and the best."""
DRAWN_CIRCLE = 361


@in_report_style
def draw_errors(result: NormalCalibration) -> Figure:
    """The worst, the middle and the best held-out press: image, error, expected error, profile."""
    order = sorted(result.heldout, key=lambda item: -item.used.mean_deg)
    shown = [order[i] for i in sorted({0, len(order) // 2, len(order) - 1})][:ROWS]
    figure, axes = new_figure(10.5, 2.75 * len(shown) + 0.3, len(shown), 4, squeeze=False)
    top = max(5.0, float(np.nanpercentile([np.nanmax(i.error_deg) for i in shown], 60)) * 0.7)
    drawn = [_draw_row(row, item, result.scene, top) for row, item in zip(axes, shown, strict=True)]
    for ax, title in zip(
        axes[0], ("captured", "error of the normals", "expected error", "depth, row"), strict=True
    ):
        ax.set_title(title)
    # Below: beside the maps it would stand at the axis of the depths.
    bar = figure.colorbar(drawn[-1], ax=axes[:, 1:3], location="bottom", shrink=0.75, aspect=30)
    bar.set_label("angle [degrees]")
    return figure


def _draw_row(row: np.ndarray, item: HeldoutNormals, scene: CaptureScene, top: float) -> AxesImage:
    grid, circle = scene.grid, item.frame.circle
    crop = crop_slices(circle, grid)
    extent = _extent(crop, grid)
    row[0].imshow(np.clip(item.frame.image[crop], 0, 255).astype(np.uint8), extent=extent)
    row[0].set_ylabel(f"{item.name}\n{item.used.mean_deg:.1f}° mean", fontsize=9)
    shown = row[1].imshow(item.error_deg[crop], extent=extent, vmin=0, vmax=top, cmap="magma")
    expected = np.where(np.isfinite(item.error_deg), item.predicted.sigma_deg * 1.2533, np.nan)
    row[2].imshow(expected[crop], extent=extent, vmin=0, vmax=top, cmap="magma")
    for ax in row[:3]:
        _draw_circle(ax, circle, grid)
        ax.set_xticks([])
        ax.set_yticks([])
    _draw_profile(row[3], item, scene)
    return shown


def _draw_profile(ax: Axes, item: HeldoutNormals, scene: CaptureScene) -> None:
    """Integrated and true depth along the row through the contact's centre."""
    grid, circle = scene.grid, item.frame.circle
    v = int(np.clip(round(circle.v_px), 0, grid.height_px - 1))
    across = (np.arange(grid.width_px) - circle.u_px) * grid.mm_per_px_x
    ratio = np.abs(across) / (circle.radius_px * grid.mm_per_px_x)
    found = -item.height_m[v] * 1e3
    wanted = ball_depth_mm(circle, scene)[v]
    rim = np.abs(ratio - 1) < 0.06
    offset = found[rim].mean() - wanted[rim].mean() if rim.any() else 0.0
    near = ratio < 2.2
    inside = ratio <= 1
    ax.plot(across[near], found[near], color=BLUE, label="integrated")
    ax.plot(across[inside], wanted[inside] + offset, color=ORANGE, ls="--", label="ball")
    ax.axhline(0, color=LIGHT, lw=0.8)
    ax.invert_yaxis()
    ax.set_xlabel("x [mm]")
    ax.set_ylabel("depth [mm]")
    ax.legend(fontsize=7, loc="lower left", handlelength=1.2)


def _extent(crop: tuple[slice, slice], grid: PixelGrid) -> tuple[float, float, float, float]:
    rows, columns = crop
    left, right = (columns.start - 0.5) * grid.mm_per_px_x, (columns.stop - 0.5) * grid.mm_per_px_x
    top, bottom = (rows.start - 0.5) * grid.mm_per_px_y, (rows.stop - 0.5) * grid.mm_per_px_y
    return left, right, bottom, top


def _draw_circle(ax: Axes, circle: ContactCircle, grid: PixelGrid) -> None:
    angle = np.linspace(0, 2 * np.pi, DRAWN_CIRCLE)
    radius = circle.radius_px * grid.mm_per_px_x
    ax.plot(
        circle.u_px * grid.mm_per_px_x + radius * np.cos(angle),
        circle.v_px * grid.mm_per_px_y + radius * np.sin(angle),
        color="white",
        lw=0.8,
        ls=":",
    )


@in_report_style
def draw_reliability(result: NormalCalibration) -> Figure:
    """Observed over expected errors of held-out pixels."""
    found = result.reliability
    assert found is not None
    figure, ax = new_figure(4.6, 4.0)
    top = 1.1 * max(*found.expected_deg, *found.observed_deg)
    ax.plot([0, top], [0, top], color=LIGHT, lw=1.2, label="as expected")
    ax.plot(found.expected_deg, found.observed_deg, "o-", color=BLUE, label="held-out pixels")
    ax.set_xlim(0, top)
    ax.set_ylim(0, top)
    ax.set_aspect("equal")
    ax.set_xlabel("expected error [degrees]")
    ax.set_ylabel("observed error [degrees]")
    ax.set_title(
        f"within the 68 % radius: {found.within_68:.0%}, within the 95 % radius: "
        f"{found.within_95:.0%}",
        fontsize=9,
    )
    ax.legend(loc="upper left")
    return figure
