# SPDX-License-Identifier: Apache-2.0
"""The page of a background: what was made of the frames, and what their light did."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.background.result import BackgroundCalibration, speck_count
from taccel_lab.files.atomic_file import write_image
from taccel_lab.printable import counted
from taccel_lab.report.lead import Score
from taccel_lab.report.page import Page, Table, picture, sentence
from taccel_lab.report.style import CHANNELS, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 24
"""Frames in its table."""


def background_page(result: BackgroundCalibration) -> Page:
    """The page of ``taccel-lab calibrate background``."""
    figures = result.figures()
    noise = "unknown" if result.noise_levels is None else f"{result.noise_levels:.2f} levels"
    rows = [
        (f.name, f.kind, 100 * f.seen_share, f.plain_l1, f.corrected_l1)
        + tuple(round(float(x), 3) for x in f.drift.gain)
        + tuple(round(float(x), 2) for x in f.drift.offset)
        for f in sorted(result.frames, key=lambda f: -f.plain_l1)[:SHOWN]
    ]
    columns = (
        "frame", "kind", "untouched %", "error before", "error after",
        "gain R", "gain G", "gain B", "offset R", "offset G", "offset B",
    )  # fmt: skip
    return Page(
        "Image of the untouched sensor",
        f"The background, made of {counted(len(result.frames), 'frame')}. Where nothing touches "
        f"the gel, a frame differs from one background image by {figures['plain_l1']:.2f} levels "
        f"on average, and from the background made of the other frames, brought to its light, by "
        f"{figures['heldout_l1']:.2f}. Noise of a pixel between frames: {noise}. Specks in the "
        f"background: {speck_count(result.dust)}.",
        result.remarks,
        [
            Table(
                "Light of each frame",
                columns,
                rows,
                f"The {len(rows)} of {len(result.frames)} frames that differ most. Mean absolute "
                "errors in levels of 255 over the untouched part, before and after the frame's "
                "light is taken off; gain and offset against the background.",
                folded=True,
            ),
            *_spread_tables(result),
        ],
        [_images(result), _drift(result)],
        figures,
        {"dust.png": lambda path: _write_mask(path, result.clean)},
        scores=[
            Score(
                f"{figures['heldout_l1']:.2f}",
                "levels of 255",
                "mean error where nothing touches",
                f"{len(result.frames)} frames, each by a background made of the others; one image "
                f"alone: {figures['plain_l1']:.2f}",
            )
        ],
    )


def _spread_tables(result: BackgroundCalibration) -> list[Table]:
    block = result.perturbation
    if block is None:
        return []
    values = block.model_dump(exclude={"provenance"}, exclude_none=True)
    rows = [(k, *v) if isinstance(v, tuple) else (k, v, None, None) for k, v in values.items()]
    columns = ("quantity", "red or value", "green", "blue")
    caption = sentence("; ".join((block.provenance.method, *block.provenance.remarks)))
    title = "How much light differs between frames: sensors to simulate are drawn from it"
    return [Table(title, columns, rows, caption, folded=True)]


def _write_mask(path: Path, mask: np.ndarray) -> None:
    """Writes an image that serves as the captures' mask: 255 where the gel is clean."""
    write_image(path, mask.astype(np.uint8) * 255)


@picture(
    "background",
    "Left the background, right the noise of each pixel between frames, white where too few frames "
    "leave it untouched; specks in red.",
)
def _images(result: BackgroundCalibration) -> Figure:
    height, width = result.image.shape[:2]
    # Tall images in panels as wide as others would be shrunk with their words.
    wide = min(10.5, 1.6 + 9.0 * width / height)
    figure, axes = new_figure(wide, 0.6 + 0.45 * wide * height / width, 1, 2)
    shown = result.image / 255
    axes[0].imshow(np.clip(shown, 0, 1))
    axes[0].contour(result.dust | result.new_dust, levels=[0.5], colors="red", linewidths=0.8)
    axes[0].set_title("background")
    known = result.noise[np.isfinite(result.noise)]
    top = float(np.percentile(known, 99)) if len(known) else 1.0
    picture = axes[1].imshow(result.noise, vmin=0, vmax=max(top, 0.5), cmap="viridis")
    axes[1].set_title("noise between frames" if len(known) else "noise: too few frames")
    figure.colorbar(picture, ax=axes[1], label="standard deviation [levels]", shrink=0.85)
    for axis in axes:
        axis.set(xlabel="u [px]", ylabel="v [px]")
    return figure


@picture(
    "drift",
    "Change of the untouched gel in each frame at the background's mean level, in the order of the "
    "captures.",
)
def _drift(result: BackgroundCalibration) -> Figure:
    level = result.image.reshape(-1, 3).mean(axis=0)
    shifts = np.array([f.drift.shift(level) for f in result.frames])
    figure, axis = new_figure(10.5, 3.4)
    for c, (name, color) in enumerate(CHANNELS):
        axis.plot(shifts[:, c], "o-", color=color, label=name, markersize=3, linewidth=1)
    axis.axhline(0, color="0.6", linewidth=0.8)
    axis.set(xlabel="frame", ylabel="change [levels of 255]")
    axis.legend(ncols=3, loc="best")
    axis.grid(axis="y")
    return figure
