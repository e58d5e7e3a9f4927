# SPDX-License-Identifier: Apache-2.0
"""The touch that one image shows, as files: arrays, figures and a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.pressure.touch import TouchReading, force_words
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_json
from taccel_lab.files.images import read_grey
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.report.style import (
    BLUE,
    LIGHT,
    ORANGE,
    in_report_style,
    new_figure,
    save_figure,
)
from taccel_lab.signals.read_heights import BAND_SIGMAS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ARRAYS = (
    "height_m",
    "rise_m",
    "height_sigma_m",
    "reading_sigma_m",
    "normals",
    "sigma_deg",
    "radius95_deg",
    "beyond_balls",
    "saturated",
)
"""Of a reading, as they are stored; those that its method does not give are left out."""


def read_mask(path: Path, profile: SensorProfile) -> np.ndarray:
    """Pixels that count, from a grey image of the profile's size, bool, shape [h, w].

    Raises:
        InputError: No image, another size, or no pixel that counts.
    """
    mask = read_grey(path) > 0
    expected = (profile.camera.height_px, profile.camera.width_px)
    if mask.shape != expected or not mask.any():
        raise InputError(
            f"{path} is {mask.shape[1]}x{mask.shape[0]} px with {int(mask.sum())} "
            f"usable pixels; {expected[1]}x{expected[0]} px and some non-zero ones needed"
        )
    return mask


def write_reading(
    found: TouchReading, image: np.ndarray, source: Path, profile: SensorProfile, folder: Path
) -> dict[str, Any]:
    """Write ``NAME.npz``, ``NAME.png`` and ``NAME.json`` into ``folder``; returns the figures.

    ``image`` is what was read, RGB levels; it came from the file ``source``, whose name is taken.
    """
    stored: dict[str, Any] = {}
    for key in ARRAYS:
        value = getattr(found, key)
        if value is not None:
            stored[key] = value if value.dtype == bool else value.astype(np.float32)
    if found.press is not None:
        stored["pressure_pa"] = found.pressure_pa.astype(np.float32)
    np.savez_compressed(folder / f"{source.stem}.npz", **stored)
    picture = draw_reading(image, found, profile.grid(), source.stem)
    save_figure(picture, folder / f"{source.stem}.png")
    figures = {"image": str(source), **found.figures(profile.grid())}
    write_json(folder / f"{source.stem}.json", figures)
    return figures


@in_report_style
def draw_reading(
    image: np.ndarray | None, found: TouchReading, grid: PixelGrid, title: str
) -> Figure:
    """Image, depth and pressure maps, and the section through the deepest pixel; no image when
    None, no pressure where there is none."""
    depth_mm = -1e3 * found.rise_m
    extent = (0.0, grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y, 0.0)
    maps = [("depth [mm]", depth_mm, "viridis")]
    if found.press is not None:
        maps.append(("pressure [kPa]", 1e-3 * found.pressure_pa, "magma"))
    pictures = len(maps) + (image is not None)
    figure, axes = new_figure(3.7 * (pictures + 1), 3.3, 1, pictures + 1)
    axes[0].set_title(title, fontsize="medium")
    if image is not None:
        axes[0].imshow(np.clip(image, 0, 255).astype(np.uint8), extent=extent)
    for ax, (label, values, colors) in zip(axes[pictures - len(maps) :], maps, strict=False):
        shown = ax.imshow(values, extent=extent, cmap=colors)
        figure.colorbar(shown, ax=ax, shrink=0.8).set_label(label)
    if found.press is not None:
        axes[pictures - 1].set_title(force_words(found.press), fontsize="medium")
    for ax in axes[:pictures]:
        ax.set_xlabel("x [mm]")
    axes[0].set_ylabel("y [mm]")
    row, column = np.unravel_index(int(np.argmax(depth_mm)), depth_mm.shape)
    x = np.arange(grid.width_px) * grid.mm_per_px_x
    y = np.arange(grid.height_px) * grid.mm_per_px_y
    axes[-1].axhline(0, color=LIGHT, lw=0.8)
    sections = (
        ("along x", BLUE, x - x[column], np.s_[row, :]),
        ("along y", ORANGE, y - y[row], np.s_[:, column]),
    )
    for label, color, away, section in sections:
        axes[-1].plot(away, depth_mm[section], color=color, label=label)
        if found.height_sigma_m is not None:
            depth = depth_mm[section]
            band = BAND_SIGMAS * 1e3 * found.height_sigma_m[section]
            axes[-1].fill_between(away, depth - band, depth + band, color=color, alpha=0.2, lw=0)
    axes[-1].invert_yaxis()
    axes[-1].set_xlabel("from the deepest point [mm]")
    axes[-1].set_ylabel("depth [mm]")
    axes[-1].legend(loc="lower right")
    return figure
