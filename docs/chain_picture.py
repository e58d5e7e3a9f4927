# SPDX-License-Identifier: Apache-2.0
"""Draws docs/images/chain.png: a pad from its CAD, a press on it, the image that its camera sees.

taccel-lab design gelsight_mini --out out/design
taccel-lab press gelsight_mini --indenter sphere:3 --depth-mm 1.6 --out out/press
taccel-lab preview gelsight_mini --out out/preview
python docs/chain_picture.py out/design out/press out/preview docs/images/chain.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyvista as pv
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.image import imread
from numpy.typing import NDArray

SIZE = (760, 570)
COLORS = "magma_r"


def pad(folder: Path) -> NDArray[np.uint8]:
    """The pad's mesh, drawn."""
    grid = pv.UnstructuredGrid(folder / "pad.vtu")
    return _drawn(grid.extract_surface(algorithm=None), show_edges=True, color="#e8c9a0")


def pressed(folder: Path) -> tuple[NDArray[np.uint8], float]:
    """The pressed gel, cut through the middle, coloured by displacement, and the largest [mm]."""
    grid = pv.UnstructuredGrid(folder / "gel.vtu")
    half = grid.clip(normal="y", origin=(0.0, 0.0, 0.0), invert=False)
    half["mm"] = np.linalg.norm(np.asarray(half["displacement_m"]), axis=1) * 1e3
    most = float(half["mm"].max())
    drawn = _drawn(half, scalars="mm", cmap=COLORS, clim=(0.0, most), show_scalar_bar=False)
    return drawn, most


def _drawn(mesh: pv.DataSet, **how: object) -> NDArray[np.uint8]:
    plotter = pv.Plotter(off_screen=True, window_size=list(SIZE))
    plotter.set_background("white")  # pyright: ignore[reportArgumentType]
    plotter.add_mesh(mesh, edge_color="#8a6a40", line_width=0.5, **how)  # pyright: ignore
    plotter.camera_position = [(-0.6, -1.6, 0.9), (0, 0, 0), (0, 0, 1)]
    plotter.reset_camera()  # pyright: ignore[reportCallIssue]
    plotter.camera.zoom(1.35)
    return np.asarray(plotter.screenshot(return_img=True))


def main(design: Path, press: Path, preview: Path, out: Path) -> None:
    """Draw the three side by side and write the picture."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
    gel, most_mm = pressed(press)
    pictures = [
        ("CAD pad, meshed", pad(design)),
        ("pressed by a ball, cut open", gel),
        ("what the camera sees (predicted)", imread(preview / "pressed.png")),
    ]
    for ax, (title, picture) in zip(axes, pictures, strict=True):
        ax.imshow(picture)
        ax.set_title(title, fontsize=13)
        ax.axis("off")
    colors = ScalarMappable(Normalize(0.0, most_mm), COLORS)
    bar = figure.colorbar(colors, ax=axes[1], orientation="horizontal", shrink=0.6, aspect=25)
    bar.set_label("displacement [mm]", fontsize=12)
    bar.ax.tick_params(labelsize=12)
    figure.savefig(out, dpi=110, bbox_inches="tight", pad_inches=0.1)


if __name__ == "__main__":
    main(*(Path(name) for name in sys.argv[1:5]))
