# SPDX-License-Identifier: Apache-2.0
"""The picture of a reading: image, maps and a section."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.heights import BAND_SIGMAS
from taccel_lab.report.style import BLUE, LIGHT, ORANGE, in_report_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_KPA = 0.1
"""Top of the scale of pressures of a gel that nothing touches."""


@in_report_style
def draw_maps(
    image: np.ndarray,
    depth_m: np.ndarray,
    sigma_m: np.ndarray | None,
    pressure_pa: np.ndarray | None,
    grid: PixelGrid,
    deepest_px: tuple[int, int],
    titles: tuple[str, str, str],
) -> Figure:
    """Image, depth and pressure maps, and the section through the deepest pixel.

    Args:
        image: RGB levels, shape [height_px, width_px, 3] of ``grid``.
        depth_m: Depth [m], shape [height_px, width_px].
        sigma_m: Its standard deviation [m], likewise; None where it is not known.
        pressure_pa: Pressure [Pa], likewise; None where there is none.
        deepest_px: Row and column that the sections go through, and whose depth ends the scale.
        titles: Over image, depth and pressure.
    """
    depth_mm = 1e3 * depth_m
    extent = (0.0, grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y, 0.0)
    maps = [("depth [mm]", depth_mm, "viridis")]
    if pressure_pa is not None:
        maps.append(("pressure [kPa]", 1e-3 * pressure_pa, "magma"))
    pictures = len(maps) + 1
    figure, axes = new_figure(3.7 * (pictures + 1), 3.3, 1, pictures + 1)
    axes[0].imshow(np.clip(image, 0, 255).astype(np.uint8), extent=extent)
    for ax, (label, values, colors) in zip(axes[1:pictures], maps, strict=True):
        if values is depth_mm:
            low, most = None, float(depth_mm[deepest_px])
        else:
            low, most = 0.0, max(float(values.max()), LEAST_KPA)
        shown = ax.imshow(values, extent=extent, cmap=colors, vmin=low, vmax=most)
        figure.colorbar(shown, ax=ax, shrink=0.8).set_label(label)
    for ax, title in zip(axes[:pictures], titles, strict=False):
        ax.set_title(title, fontsize="medium")
        ax.set_xlabel("x [mm]")
    axes[0].set_ylabel("y [mm]")
    row, column = deepest_px
    x = np.arange(grid.width_px) * grid.mm_per_px_x
    y = np.arange(grid.height_px) * grid.mm_per_px_y
    axes[-1].axhline(0, color=LIGHT, lw=0.8)
    sections = (
        ("along x", BLUE, x - x[column], np.s_[row, :]),
        ("along y", ORANGE, y - y[row], np.s_[:, column]),
    )
    for label, color, away, section in sections:
        axes[-1].plot(away, depth_mm[section], color=color, label=label)
        if sigma_m is not None:
            depth = depth_mm[section]
            band = BAND_SIGMAS * 1e3 * sigma_m[section]
            axes[-1].fill_between(away, depth - band, depth + band, color=color, alpha=0.2, lw=0)
    axes[-1].invert_yaxis()
    axes[-1].set(xlabel="from the deepest point [mm]", ylabel="depth [mm]")
    axes[-1].legend(loc="lower right")
    return figure
