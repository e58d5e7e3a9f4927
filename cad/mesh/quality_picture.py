# SPDX-License-Identifier: Apache-2.0
"""A picture of what is wrong with a mesh and where, drawn with matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.cad.mesh.quality_gate import GateResult, bad_tets
from taccel_lab.cad.mesh.quality_measures import TET_FACES
from taccel_lab.geometry import TetMesh
from taccel_lab.output import atomic_file

PICTURE_NAME = "bad_mesh.png"
_BAD, _PLACE = "#d4301f", "#1f5fd4"
_LEAST_ZOOM_MM = 1.0
_MOST_TEXT = 150


def write_bad_mesh(mesh: TetMesh, result: GateResult, folder: Path | str) -> Path:
    """Draw the surface of ``mesh`` in light grey, bad tets in red, other bad places as crosses.

    On the left the whole mesh, on the right the worst place from close by. Returns the file,
    ``PICTURE_NAME`` in ``folder``.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    nodes = mesh.nodes_m * 1e3
    bad = np.flatnonzero(bad_tets(mesh, result.gate))
    places = np.array([v.at_mm for v in result.violations if v.at_mm is not None]).reshape(-1, 3)
    figure = Figure(figsize=(13, 6.4), dpi=110)
    FigureCanvasAgg(figure)
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    whole: Any = figure.add_subplot(1, 2, 1, projection="3d", computed_zorder=False)
    close: Any = figure.add_subplot(1, 2, 2, projection="3d", computed_zorder=False)
    view = _view(places, nodes)
    _draw(whole, mesh, nodes, bad, places, alpha=0.18, line=0.15)
    _frame(whole, low, high, "whole mesh", view)
    center, reach = _zoom(mesh, nodes, bad, places)
    near = (np.abs(nodes[mesh.faces].mean(axis=1) - center) < reach).all(axis=1)
    near_bad = bad[(np.abs(nodes[mesh.tets[bad]].mean(axis=1) - center) < reach).all(axis=1)]
    inside = (np.abs(places - center) < reach).all(axis=1)
    _draw(close, mesh, nodes, near_bad, places[inside], alpha=0.25, line=0.6, faces=near)
    _frame(close, center - reach, center + reach, f"worst place, {2 * reach:.2g} mm wide", view)
    handles = [
        Patch(facecolor="0.85", edgecolor="0.5", label="surface"),
        Patch(facecolor=_BAD, label=f"{len(bad)} bad tets"),
        Line2D([], [], color=_PLACE, marker="x", linestyle="", label="worst place of each limit"),
    ]
    figure.legend(handles=handles, loc="lower center", ncols=3, frameon=False)
    lines = [_shortened(v.text) for v in result.violations] or ["all limits are kept"]
    figure.suptitle("\n".join(lines), fontsize=9, y=0.99, va="top")
    top = 0.97 - 0.025 * len(lines)
    figure.subplots_adjust(left=0.01, right=0.95, bottom=0.09, top=top, wspace=0.08)
    path = Path(folder) / PICTURE_NAME
    with atomic_file(path) as staging:
        figure.savefig(staging, format="png")
    return path


def _draw(
    axes: Any,
    mesh: TetMesh,
    nodes: np.ndarray,
    bad: np.ndarray,
    places: np.ndarray,
    *,
    alpha: float,
    line: float,
    faces: np.ndarray | slice = slice(None),
) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    grey = Poly3DCollection(
        list(nodes[mesh.faces[faces]]), facecolors=(0.8, 0.8, 0.8, alpha),
        edgecolors=(0.45, 0.45, 0.45, 0.5), linewidths=line,
        zorder=1,
    )  # fmt: skip
    axes.add_collection3d(grey)
    if len(bad):
        corners = nodes[mesh.tets[bad]][:, TET_FACES].reshape(-1, 3, 3)
        red = Poly3DCollection(
            list(corners), facecolors=_BAD, edgecolors="#7a1108", linewidths=0.7, zorder=2
        )
        axes.add_collection3d(red)
    if len(places):
        axes.scatter(*places.T, marker="x", s=70, color=_PLACE, depthshade=False, zorder=10)


def _frame(
    axes: Any, low: np.ndarray, high: np.ndarray, title: str, view: tuple[float, float]
) -> None:
    axes.set(
        xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]),
        xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]",
    )  # fmt: skip
    axes.set_title(title, fontsize=10)
    axes.set_box_aspect(high - low, zoom=1.0)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(_few_ticks())
    axes.tick_params(labelsize=8)
    axes.view_init(elev=view[0], azim=view[1])


def _few_ticks() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=4)


def _view(places: np.ndarray, nodes: np.ndarray) -> tuple[float, float]:
    """Elevation and azimuth [deg] of the side on which the first bad place lies."""
    middle = 0.5 * (nodes.min(axis=0) + nodes.max(axis=0))
    arm = (places[0] if len(places) else nodes.max(axis=0)) - middle
    azimuth = np.rad2deg(np.arctan2(arm[1], arm[0])) if np.hypot(*arm[:2]) > 1e-6 else -60.0
    return (-24.0 if arm[2] < -0.25 * np.ptp(nodes[:, 2]) else 28.0), float(azimuth) + 25.0


def _zoom(
    mesh: TetMesh, nodes: np.ndarray, bad: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, float]:
    """Middle and half width of the close view [mm]."""
    if len(places):
        center = places[0]
    elif len(bad):
        center = nodes[mesh.tets[bad[0]]].mean(axis=0)
    else:
        center = nodes.mean(axis=0)
    nearest = int(np.linalg.norm(nodes[mesh.tets].mean(axis=1) - center, axis=1).argmin())
    size = float(np.ptp(nodes[mesh.tets[nearest]], axis=0).max())
    return center, max(2.2 * size, _LEAST_ZOOM_MM)


def _shortened(text: str) -> str:
    return text if len(text) <= _MOST_TEXT else text[: _MOST_TEXT - 3] + "..."
