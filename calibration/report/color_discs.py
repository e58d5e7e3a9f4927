# SPDX-License-Identifier: Apache-2.0
"""What a colour model answers to every normal at a few places of the image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.files.atomic_file import eight_bit
from taccel_lab.profile import SensorProfile
from taccel_lab.report.style import GREY, in_report_style, new_figure
from taccel_lab.signals.color_model import ColorModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLACES = ((0.5, 0.5), (0.2, 0.25), (0.8, 0.25), (0.2, 0.75), (0.8, 0.75))
"""Shares of the image's width and height: the middle and near the corners."""
DISC_SIZE = 65
SPAN = 0.7
"""Largest sine of the tilt at which colours are compared: 44 degrees."""
DISPLACEMENT_MM = -0.3
"""Indentation at which they are compared [mm]."""


@dataclass(frozen=True)
class NormalDisc:
    """Colour change that the model predicts at one pixel over the hemisphere of normals."""

    pixel_uv: tuple[float, float]
    delta_rgb: np.ndarray
    """Colour change [levels], shape [n, n, 3]: rows ny, columns nx from -``SPAN`` to ``SPAN``
    (``disc_normals``); NaN outside the disc."""


def disc_normals(count: int, max_sine: float) -> np.ndarray:
    """Unit normals over a disc of (nx, ny) for ``NormalDisc``: shape [count, count, 3].

    Rows run over ny and columns over nx from -max_sine to max_sine; NaN outside the disc.
    """
    axis = np.linspace(-max_sine, max_sine, count)
    nx, ny = np.meshgrid(axis, axis)
    sine2 = nx**2 + ny**2
    nz = np.sqrt(np.where(sine2 <= max_sine**2 * (1 + 1e-12), 1 - sine2, np.nan))
    return np.stack([np.where(np.isnan(nz), np.nan, n) for n in (nx, ny, nz)], axis=-1)


def profile_discs(profile: SensorProfile) -> tuple[NormalDisc, ...]:
    """Colour change over the hemisphere of normals at ``PLACES``; empty without a colour model."""
    model = ColorModel.from_profile(profile)
    if model is None:
        return ()
    normals = disc_normals(DISC_SIZE, SPAN)
    seen = np.isfinite(normals[..., 0])
    count = int(seen.sum())
    width, height = model.config.width_px, model.config.height_px
    discs = []
    for share_u, share_v in PLACES:
        u, v = round(share_u * (width - 1)), round(share_v * (height - 1))
        delta = np.full((*seen.shape, 3), np.nan)
        delta[seen] = model.predict_pixels(
            np.full(count, v * width + u),
            normals[seen],
            np.full(count, DISPLACEMENT_MM),
            np.broadcast_to([0.0, 0.0, 1.0], (count, 3)),
        )
        discs.append(NormalDisc((u, v), delta))
    return tuple(discs)


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
        image = panel.imshow(
            eight_bit(128 + disc.delta_rgb),
            extent=(-SPAN, SPAN, SPAN, -SPAN),
            interpolation="bilinear",
        )
        panel.set_title(f"u {disc.pixel_uv[0]:.0f}, v {disc.pixel_uv[1]:.0f}", color=GREY)
        panel.plot(0, 0, "+", color="black", markersize=6, markeredgewidth=0.8)
        # Clipped a little inside the disc, where all neighbours of a sample are known.
        rim = Circle((0, 0), 0.97 * SPAN, fill=False, edgecolor=GREY, linewidth=0.8)
        panel.add_patch(rim)
        image.set_clip_path(rim)
    return figure
