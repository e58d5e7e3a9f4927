# SPDX-License-Identifier: Apache-2.0
"""Pictures of a check: coverage, drift of the light, frames with their circles, two framings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.capture.coverage import coverage_map
from taccel_lab.calibration.check.background import BackgroundCheck
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.check.presses import found_circles
from taccel_lab.geometry import PixelGrid
from taccel_lab.report.style import CHANNELS, GREEN, INK, ORANGE, in_report_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHEET_COLUMNS, SHEET_FRAMES = 4, 60


@in_report_style
def draw_coverage(
    frames: Sequence[FrameFigures], background: np.ndarray, grid: PixelGrid
) -> Figure:
    """Contacts over the untouched gel, and how often each pixel was touched."""
    aspect = grid.height_px / grid.width_px
    width = 8.6 if aspect <= 1 else 7.4
    figure, axes = new_figure(width, 1.0 + 0.4 * width * aspect, 1, 2)
    figure.set_layout_engine("compressed")
    axes[0].imshow(background)
    for frame in frames:
        if frame.circle is not None:
            color = GREEN if frame.contact is not None else ORANGE
            _circle(axes[0], frame.circle, grid, color, "-", 1.0)
    axes[0].set_title(f"{len(frames)} presses")
    count = coverage_map(found_circles(frames), grid)
    top = max(1, int(count.max()))
    drawn = axes[1].imshow(count, cmap="viridis", vmin=0, vmax=top)
    ticks = np.unique(np.linspace(0, top, min(top, 5) + 1).round())
    figure.colorbar(drawn, ax=axes[1], label="contacts on a pixel", ticks=ticks)
    axes[1].set_title(f"{(count > 0).mean():.0%} of the image touched")
    for panel in axes:
        panel.set_xlim(-0.5, grid.width_px - 0.5)
        panel.set_ylim(grid.height_px - 0.5, -0.5)
        panel.set_xlabel("u [px]")
    axes[0].set_ylabel("v [px]")
    return figure


@in_report_style
def draw_light(frames: Sequence[FrameFigures]) -> Figure:
    """Colour of the untouched gel over the frames, against the background."""
    figure, axes = new_figure(8.6, 2.6)
    shifts = np.stack([frame.shift_levels for frame in frames])
    for channel, (name, color) in enumerate(CHANNELS):
        axes.plot(shifts[:, channel], marker=".", lw=1, color=color, label=name)
    axes.axhline(0, color=INK, lw=0.6)
    axes.set_xlabel("press, in the order of the manifest")
    axes.set_ylabel("untouched gel less\nbackground [levels]")
    axes.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    return figure


@in_report_style
def draw_frames(
    frames: Sequence[FrameFigures], remarks: dict[str, list[str]], grid: PixelGrid
) -> Figure:
    """The first ``SHEET_FRAMES`` frames: contact found, label, findings."""
    chosen = frames[:SHEET_FRAMES]
    columns = min(SHEET_COLUMNS, len(chosen))
    rows = -(-len(chosen) // columns)
    aspect = grid.height_px / grid.width_px
    figure, axes = new_figure(
        2.3 * columns + 0.2, rows * (2.2 * aspect + 0.62), rows, columns, squeeze=False
    )
    for panel in axes.ravel():
        panel.set_axis_off()
    for panel, frame in zip(axes.ravel(), chosen, strict=False):
        panel.imshow(np.clip(frame.press.image(), 0, 255))
        if frame.press.circle is not None:
            _circle(panel, frame.press.circle, grid, "white", "--", 1.2)
        if frame.contact is not None:
            _circle(panel, frame.contact.circle, grid, ORANGE, "-", 1.2)
        panel.set_xlim(-0.5, grid.width_px - 0.5)
        panel.set_ylim(grid.height_px - 0.5, -0.5)
        codes = remarks.get(frame.press.name, [])
        text = ", ".join(code.replace("_", " ") for code in codes[:3]) or "no remark"
        panel.set_title(f"{_short(frame.press.name)}\n{text}", fontsize=8)
    return figure


@in_report_style
def draw_framings(check: BackgroundCheck, background: np.ndarray) -> Figure:
    """The background beside the median of the presses."""
    figure, axes = new_figure(8.6, 1.0 + 4.0 * background.shape[0] / background.shape[1], 1, 2)
    figure.set_layout_engine("compressed")
    axes[0].imshow(background)
    axes[0].set_title("background as given")
    axes[1].imshow(check.image)
    axes[1].set_title("median of the presses")
    for panel in axes:
        panel.set_xlabel("u [px]")
    axes[0].set_ylabel("v [px]")
    return figure


def _short(name: str) -> str:
    return name if len(name) <= 26 else name[:12] + "…" + name[-12:]


def _circle(
    panel: Any, circle: ContactCircle, grid: PixelGrid, color: str, line: str, width: float
) -> None:
    from matplotlib.patches import Ellipse

    high = 2 * circle.radius_px * grid.mm_per_px_x / grid.mm_per_px_y
    panel.add_patch(
        Ellipse(
            (circle.u_px, circle.v_px), 2 * circle.radius_px, high,
            fill=False, ec=color, ls=line, lw=width,
        )
    )  # fmt: skip
