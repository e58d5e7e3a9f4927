# SPDX-License-Identifier: Apache-2.0
"""Pictures of two profiles side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.report.color_discs import profile_discs
from taccel_lab.profile import SensorProfile
from taccel_lab.report.style import GREY, in_report_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GAIN = 2.0
"""Differences are drawn this much stronger."""


@in_report_style
def draw_backgrounds(a: SensorProfile, b: SensorProfile, names: tuple[str, str]) -> Figure:
    """Both images at rest and, where their sizes agree, the difference about middle grey."""
    first, second = a.background_rgb, b.background_rgb
    assert first is not None and second is not None
    same = first.shape == second.shape
    ratio = first.shape[0] / first.shape[1]
    figure, axes = new_figure(9.6, 3.3 * ratio + 0.6, 1, 3 if same else 2, squeeze=False)
    images = [(names[0], first), (names[1], second)]
    if same:
        change = second.astype(np.float64) - first
        images.append((f"difference x {GAIN:g}", 128 + GAIN * change))
    for panel, (title, image) in zip(axes.ravel(), images, strict=True):
        panel.imshow(np.clip(image, 0, 255).astype(np.uint8))
        panel.set_title(title)
        panel.set_axis_off()
    return figure


@in_report_style
def draw_color_responses(a: SensorProfile, b: SensorProfile, names: tuple[str, str]) -> Figure:
    """Rows a, b and their difference; a column for each place of the image."""
    first, second = profile_discs(a), profile_discs(b)
    figure, axes = new_figure(1.8 * len(first) + 0.6, 6.0, 3, len(first))
    for column, (one, two) in enumerate(zip(first, second, strict=True)):
        rows = (
            128 + one.delta_rgb,
            128 + two.delta_rgb,
            128 + GAIN * (two.delta_rgb - one.delta_rgb),
        )
        for row, image in enumerate(rows):
            panel = axes[row, column]
            outside = np.isnan(image[..., 0])
            levels = np.clip(np.nan_to_num(image, nan=255.0), 0, 255).astype(np.uint8)
            levels[outside] = 255
            panel.imshow(levels)
            panel.set_xticks([])
            panel.set_yticks([])
            for spine in panel.spines.values():
                spine.set_visible(False)
        axes[0, column].set_title(f"u {one.pixel_uv[0]:.0f}, v {one.pixel_uv[1]:.0f}", color=GREY)
    for row, label in enumerate((*names, f"difference x {GAIN:g}")):
        axes[row, 0].set_ylabel(label)
    return figure
