# SPDX-License-Identifier: Apache-2.0
"""Report of a background calibration: the image, the light of each frame, noise and dust."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.light.background_result import BackgroundCalibration
from taccel_lab.calibration.light.dust import speck_count
from taccel_lab.files.atomic_file import write_image
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.style import CHANNELS, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 24


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
        "frame", "kind", "untouched %", "L1 before", "L1 after",
        "gain R", "gain G", "gain B", "offset R", "offset G", "offset B",
    )  # fmt: skip
    return Page(
        "Background",
        f"{len(result.frames)} frames. Mean error of untouched gel: {figures['plain_l1']:.2f} "
        f"levels with one background image, {figures['heldout_l1']:.2f} with the background "
        "made of the other frames in the frame's light. "
        f"Noise of a pixel between frames: {noise}. Specks in the background: "
        f"{speck_count(result.dust)}.",
        result.remarks,
        [
            Table(
                "Light of each frame",
                columns,
                rows,
                f"The {len(rows)} of {len(result.frames)} frames that differ most. Levels of 255, "
                "over the untouched part; gain and offset against the background.",
            ),
            *_spread_tables(result),
        ],
        [_images(result), _drift(result)],
        figures,
        {"dust.png": lambda path: _write_mask(path, result.clean)},
    )


def _spread_tables(result: BackgroundCalibration) -> list[Table]:
    block = result.perturbation
    if block is None:
        return []
    values = block.model_dump(exclude={"provenance"}, exclude_none=True)
    rows = [(k, *v) if isinstance(v, tuple) else (k, v, None, None) for k, v in values.items()]
    columns = ("quantity", "red or value", "green", "blue")
    caption = "; ".join((block.provenance.method.capitalize(), *block.provenance.remarks))
    return [Table("Spread, from which sensors are drawn", columns, rows, caption=caption)]


def _write_mask(path: Path, mask: np.ndarray) -> None:
    """Writes an image that serves as the captures' mask: 255 where the gel is clean."""
    write_image(path, mask.astype(np.uint8) * 255)


@picture(
    "background",
    "Left the background, right the noise of each pixel between frames; specks in red.",
)
def _images(result: BackgroundCalibration) -> Figure:
    height, width = result.image.shape[:2]
    figure, axes = new_figure(10.5, 0.6 + 4.7 * height / width, 1, 2)
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
