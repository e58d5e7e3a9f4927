# SPDX-License-Identifier: Apache-2.0
"""The report of a depth calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.depth.block import depth_scores
from taccel_lab.calibration.depth.result import DepthCalibration
from taccel_lab.printable import counted
from taccel_lab.report.page import Page, Table, picture, sentence
from taccel_lab.report.style import BLUE, GREY, LIGHT, ORANGE, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_PIXELS = 3000
ZERO_WORDS = {
    "travel": "the travel that each press states (depth_mm)",
    "untouched": "where the grey is that of the untouched gel",
    "rim": "the rim of the contact",
}
"""What depths count from, by ``DepthOptions.zero``."""


def depth_page(result: DepthCalibration) -> Page:
    """Curve, residuals and presses of one calibration."""
    presses = Table.of(
        "Presses, worst first",
        sorted(result.presses, key=lambda p: -p.mae_mm),
        {
            "press": "name",
            "error [mm]": "mae_mm",
            "bias [mm]": "bias_mm",
            "tilt across [mm]": "plane_mm",
            "rim [px]": "radius_px",
            "± [px]": "radius_sigma_px",
            "circle": lambda p: "given" if p.given else "found",
            "depth [mm]": "depth_mm",
        },
        f"Depths count from {ZERO_WORDS[result.zero]}. Left-out pixels (a {result.left_out} at a "
        f"time) are off by {result.left_out_mm.mean():.4f} mm.",
    )
    return Page(
        "Depth of a grey sensor",
        f"Depth from the drop of the {result.response.channel} level, fitted to "
        f"{counted(len(result.presses), 'ball press', 'ball presses')} up to "
        f"{result.response.depth_mm[-1]:.2f} mm deep. {sentence(result.headline())}",
        result.remarks,
        [presses],
        [_depths(result), _curve(result)],
        result.figures(),
        scores=tuple(depth_scores(result.residuals())),
    )


@picture(
    "curve",
    "Pixels of the contacts and the curve through them; the band is two standard deviations of the "
    "curve, found by resampling eighths of the contacts.",
)
def _curve(result: DepthCalibration) -> Figure:
    """Depth over drop, and the residuals."""
    figure, axes = new_figure(8.6, 3.6, 1, 2)
    drop = np.concatenate([p.drop_levels for p in result.parts])
    depth = np.concatenate([p.depth_mm for p in result.parts])
    every = max(1, len(drop) // SHOWN_PIXELS)
    axes[0].plot(drop[::every], depth[::every], ".", ms=2, color=LIGHT, label="pixels", zorder=1)
    level, curve = result.response.drop_levels, result.response.depth_mm
    band = 2 * result.spread_mm
    axes[0].fill_between(level, curve - band, curve + band, color=BLUE, alpha=0.2, lw=0)
    axes[0].plot(level, curve, color=BLUE, label="curve")
    axes[0].set(xlabel="grey drop [levels]", ylabel="depth [mm]")
    axes[0].legend(loc="lower right")
    left = result.response.depth_of(drop) - depth
    axes[1].plot(depth[::every], left[::every], ".", ms=2, color=GREY)
    axes[1].axhline(0, color=LIGHT, lw=0.8)
    axes[1].set(xlabel="depth of the ball [mm]", ylabel="curve minus ball [mm]")
    return figure


@picture(
    "depths",
    "Depth read from the worst press, its difference from the ball inside the contact, and both "
    "along the row through the centre.",
)
def _depths(result: DepthCalibration) -> Figure:
    """The worst press: depth map, error map, and a section."""
    worst = max(range(len(result.presses)), key=lambda i: result.presses[i].mae_mm)
    captures = result.captures
    press, part, grid = result.presses[worst], result.parts[worst], captures.grid
    found = result.response.read(
        captures.presses[worst].image(), captures.background, captures.mask
    )
    error, truth = np.full((2, *found.depth_mm.shape), np.nan)
    at = (part.v_px.astype(int), part.u_px.astype(int))
    truth[at] = part.depth_mm
    error[at] = found.depth_mm[at] - part.depth_mm
    extent = (0, grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y, 0)
    figure, axes = new_figure(11.0, 3.0, 1, 3)
    shown = axes[0].imshow(found.depth_mm, extent=extent, cmap="viridis")
    figure.colorbar(shown, ax=axes[0], shrink=0.8).set_label("depth [mm]")
    axes[0].set_title(press.name)
    top = float(np.nanpercentile(np.abs(error), 99))
    shown = axes[1].imshow(error, extent=extent, cmap="RdBu_r", vmin=-top, vmax=top)
    figure.colorbar(shown, ax=axes[1], shrink=0.8).set_label("read minus ball [mm]")
    axes[0].set(xlabel="x [mm]", ylabel="y [mm]")
    axes[1].set_xlabel("x [mm]")
    row = int(np.clip(round(press.v_px), 0, grid.height_px - 1))
    x = (np.arange(grid.width_px) - press.u_px) * grid.mm_per_px_x
    axes[2].plot(x, found.depth_mm[row], color=BLUE, label="read")
    axes[2].plot(x, truth[row], color=ORANGE, ls="--", label="ball")
    axes[2].invert_yaxis()
    axes[2].set(xlabel="x from the centre [mm]", ylabel="depth [mm]")
    axes[2].legend(loc="lower right")
    return figure
