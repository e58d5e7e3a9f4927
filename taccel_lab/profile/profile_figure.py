# SPDX-License-Identifier: Apache-2.0
"""The untouched image of a profile over the gel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.report.style import in_report_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.geometry import PixelGrid


@in_report_style
def draw_image_at_rest(image: np.ndarray, grid: PixelGrid, dots_mm: np.ndarray | None) -> Figure:
    """The untouched image over the gel's x and y [mm], with the dots that the profile states.

    Args:
        image: RGB levels, [H, W, 3].
        grid: Of its pixels.
        dots_mm: Of the printed dots in the gel frame [mm], [dot, 2]; None without any.
    """
    corners = grid.gel_from_pixel(
        np.array([[-0.5, -0.5], [grid.width_px - 0.5, grid.height_px - 0.5]])
    )
    (left, top), (right, bottom) = corners
    figure, axes = new_figure(7.0, 7.0 * (bottom - top) / (right - left) + 0.6)
    axes.imshow(image.astype(np.uint8), extent=(left, right, bottom, top))
    if dots_mm is not None:
        axes.plot(dots_mm[:, 0], dots_mm[:, 1], "o", color="white", mfc="none", markersize=7)
        axes.set_xlim(left, right)
        axes.set_ylim(bottom, top)
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    return figure
