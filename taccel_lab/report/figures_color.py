# SPDX-License-Identifier: Apache-2.0
"""Figures of the colour calibration: frames side by side, the model over normals, loss, circles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.report.figures import as_uint8
from taccel_lab.report.model import DetectionSection, HeldoutFrame, LossCurve, NormalDisc
from taccel_lab.report.style import BLUE, GREEN, GREY, ORANGE, in_report_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DIFFERENCE_LEVELS = 25.0
"""Top of the difference maps' scale [levels]; fixed so that frames compare."""
_CROP_RADII = 1.6


def disc_normals(count: int = 65, max_sine: float = 0.9) -> np.ndarray:
    """Unit normals over a disc of (nx, ny) for ``NormalDisc``: shape [count, count, 3].

    Rows run over ny and columns over nx from -max_sine to max_sine; NaN outside the disc.
    """
    axis = np.linspace(-max_sine, max_sine, count)
    nx, ny = np.meshgrid(axis, axis)
    sine2 = nx**2 + ny**2
    nz = np.sqrt(np.where(sine2 <= max_sine**2 * (1 + 1e-12), 1 - sine2, np.nan))
    return np.stack([np.where(np.isnan(nz), np.nan, n) for n in (nx, ny, nz)], axis=-1)


@in_report_style
def draw_heldout_frame(frame: HeldoutFrame) -> Figure:
    """Real, rendered and absolute difference in the crop around the contact."""
    u, v, radius = frame.circle_px
    height, width = frame.real_rgb.shape[:2]
    half = _CROP_RADII * radius
    columns = slice(max(0, round(u - half)), min(width, round(u + half) + 1))
    rows = slice(max(0, round(v - half)), min(height, round(v + half) + 1))
    images = [frame.real_rgb[rows, columns], frame.rendered_rgb[rows, columns]]
    difference = np.abs(images[0].astype(np.float64) - images[1]).mean(axis=-1)
    figure, axes = new_figure(8.6, 2.75, 1, 3)
    center = (u - columns.start, v - rows.start)
    for panel, image, title in zip(axes[:2], images, ("real", "rendered"), strict=True):
        panel.imshow(as_uint8(image))
        panel.set_title(title)
        _draw_circle(panel, center, radius, "white")
    drawn = axes[2].imshow(difference, cmap="inferno", vmin=0, vmax=DIFFERENCE_LEVELS)
    axes[2].set_title("|difference|")
    _draw_circle(axes[2], center, radius, "white")
    figure.colorbar(drawn, ax=axes[2], label="levels, mean of RGB", extend="max", shrink=0.9)
    for panel in axes:
        panel.set_axis_off()
    return figure


@in_report_style
def draw_full_frame(frame: HeldoutFrame) -> Figure:
    """The same for the whole image."""
    figure, axes = new_figure(9.6, 2.35, 1, 3)
    difference = np.abs(frame.real_rgb.astype(np.float64) - frame.rendered_rgb).mean(axis=-1)
    for panel, image, title in zip(
        axes[:2], (frame.real_rgb, frame.rendered_rgb), ("real", "rendered"), strict=True
    ):
        panel.imshow(as_uint8(image))
        panel.set_title(title)
    drawn = axes[2].imshow(difference, cmap="inferno", vmin=0, vmax=DIFFERENCE_LEVELS)
    axes[2].set_title("|difference|")
    figure.colorbar(drawn, ax=axes[2], label="levels", extend="max", shrink=0.9)
    for panel in axes:
        panel.set_axis_off()
        _draw_circle(panel, frame.circle_px[:2], frame.circle_px[2], "white")
    return figure


def _draw_circle(axes: Any, center: tuple[float, float], radius: float, color: str) -> None:
    from matplotlib.patches import Circle

    axes.add_patch(
        Circle(center, radius, fill=False, edgecolor=color, linewidth=0.9, linestyle=(0, (4, 3)))
    )


@in_report_style
def draw_color_discs(discs: tuple[NormalDisc, ...]) -> Figure:
    """Colour change over (nx, ny), as grey plus change, placed as the pixels lie in the image."""
    from matplotlib.patches import Circle

    columns = sorted({disc.pixel_uv[0] for disc in discs})
    rows = sorted({disc.pixel_uv[1] for disc in discs})
    figure, axes = new_figure(
        2.1 * len(columns) + 0.6, 2.25 * len(rows), len(rows), len(columns), squeeze=False
    )
    for panel in axes.ravel():
        panel.set_axis_off()
    for disc in discs:
        panel = axes[rows.index(disc.pixel_uv[1]), columns.index(disc.pixel_uv[0])]
        span = disc.max_sine
        image = panel.imshow(
            as_uint8(128 + disc.delta_rgb),
            extent=(-span, span, span, -span),
            interpolation="bilinear",
        )
        panel.set_title(f"u {disc.pixel_uv[0]:.0f}, v {disc.pixel_uv[1]:.0f}", color=GREY)
        panel.plot(0, 0, "+", color="black", markersize=6, markeredgewidth=0.8)
        # Clipped a little inside the disc, where all neighbours of a sample are known.
        rim = Circle((0, 0), 0.97 * span, fill=False, edgecolor=GREY, linewidth=0.8)
        panel.add_patch(rim)
        image.set_clip_path(rim)
        if disc.trained_sine is not None and disc.trained_sine < span:
            panel.add_patch(
                Circle(
                    (0, 0), disc.trained_sine, fill=False, edgecolor="black", linewidth=0.8,
                    linestyle=(0, (4, 3)),
                )
            )  # fmt: skip
    return figure


@in_report_style
def draw_loss(curve: LossCurve) -> Figure:
    """Training loss on a logarithmic scale."""
    figure, axes = new_figure(6.4, 3.4)
    axes.grid(True)
    axes.plot(curve.steps, curve.train, color=BLUE, label="training")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    axes.tick_params(axis="y", which="minor", labelsize=8)
    axes.set_xlabel("step")
    axes.set_ylabel("loss")
    axes.set_title("Colour model: loss")
    axes.legend()
    return figure


@in_report_style
def draw_detection(section: DetectionSection) -> Figure:
    """Errors of the detected circles: centre offsets, and radii against the labels."""
    error = section.detected_px - section.labelled_px
    found = np.isfinite(error).all(axis=1)
    figure, (left, right) = new_figure(8.6, 3.7, 1, 2)
    left.axhline(0, color=GREY, linewidth=0.6)
    left.axvline(0, color=GREY, linewidth=0.6)
    left.scatter(error[found, 0], error[found, 1], s=22, color=BLUE, alpha=0.75, linewidths=0)
    span = max(1.0, 1.15 * float(np.abs(error[found, :2]).max(initial=0.0)))
    left.set_xlim(-span, span)
    left.set_ylim(span, -span)
    left.set_aspect("equal")
    left.set_title("centre: detected - labelled")
    left.set_xlabel("du [px]")
    left.set_ylabel("dv [px]")
    labelled = section.labelled_px[:, 2]
    low, high = float(labelled.min()), float(labelled.max())
    margin = 0.08 * (high - low) + 1.0
    line = np.array([low - margin, high + margin])
    right.fill_between(
        line, line - 2, line + 2, color=GREEN, alpha=0.12, label="±2 px", linewidth=0
    )
    right.plot(line, line, color=GREY, linewidth=0.8)
    right.scatter(
        labelled[found], section.detected_px[found, 2], s=22, color=BLUE, alpha=0.75, linewidths=0
    )
    for radius in labelled[~found]:
        right.axvline(radius, color=ORANGE, linewidth=1)
    if (~found).any():
        right.plot([], [], color=ORANGE, label=f"not found ({int((~found).sum())})")
    right.set_title("radius")
    right.set_xlabel("labelled [px]")
    right.set_ylabel("detected [px]")
    right.set_aspect("equal")
    right.legend(loc="upper left")
    return figure
