# SPDX-License-Identifier: Apache-2.0
"""A picture of what is wrong with a mesh and where, drawn with matplotlib."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.cad.mesh.quality_measures import TET_FACES
from taccel_lab.files.atomic_file import write_by
from taccel_lab.geometry import TetMesh

_BAD, _PLACE = "#d4301f", "#1f5fd4"
_LEAST_ZOOM_MM = 1.0
_MOST_TEXT = 150


def write_bad_mesh(
    mesh: TetMesh,
    bad: np.ndarray,
    places_mm: Sequence[Sequence[float]],
    texts: Sequence[str],
    folder: Path | str,
) -> Path:
    """Draw the surface of ``mesh`` in light grey, ``bad`` tets (bool, [tet_count]) in red, other
    bad places as crosses, and say the texts above: bad_mesh.png in ``folder``.
    On the left the whole mesh, on the right the worst place from close by."""
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    nodes = mesh.nodes_m * 1e3
    centers, corners = nodes[mesh.tets].mean(axis=1), nodes[mesh.tets][:, TET_FACES]
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    places = np.reshape(places_mm, (-1, 3))
    middle = np.concatenate([places, centers[bad], nodes.mean(axis=0, keepdims=True)])[0]
    nearest = int(np.linalg.norm(centers - middle, axis=1).argmin())
    reach = max(2.2 * float(np.ptp(nodes[mesh.tets[nearest]], axis=0).max()), _LEAST_ZOOM_MM)
    # Seen from the side on which the first bad place lies.
    arm = (places[0] if len(places) else high) - 0.5 * (low + high)
    azimuth = np.rad2deg(np.arctan2(arm[1], arm[0])) if np.hypot(*arm[:2]) > 1e-6 else -60.0
    view = {"elev": -24 if arm[2] < -0.25 * (high - low)[2] else 28, "azim": azimuth + 25}
    figure = Figure(figsize=(13, 6.4), dpi=110)
    around = {f"worst place, {2 * reach:.2g} mm wide": (middle - reach, middle + reach)}
    boxes = {"whole mesh": (low, high)} | around
    for column, (title, (low, high)) in enumerate(boxes.items(), 1):
        axes: Any = figure.add_subplot(1, 2, column, projection="3d", computed_zorder=False)
        for name, least, most in zip("xyz", low, high, strict=True):
            axes.set(**{f"{name}lim": (least, most), f"{name}label": f"{name} [mm]"})
            axes.locator_params(name, nbins=4)
        axes.set_title(title, fontsize=10)
        axes.set_box_aspect(high - low)
        axes.tick_params(labelsize=8)
        axes.view_init(**view)
        faces, places_in, tets = (
            ((at >= low) & (at <= high)).all(axis=1)
            for at in (nodes[mesh.faces].mean(axis=1), places, centers)
        )
        for triangles, color, edges, width in (
            (nodes[mesh.faces[faces]], (0.8, 0.8, 0.8, 0.2), (0.45, 0.45, 0.45, 0.5), 0.3),
            (corners[bad & tets].reshape(-1, 3, 3), _BAD, "#7a1108", 0.7),
        ):
            style = {"facecolors": color, "edgecolors": edges, "linewidths": width}
            axes.add_collection3d(Poly3DCollection(triangles, **style))
        crosses = places[places_in].T
        axes.scatter(*crosses, marker="x", s=70, color=_PLACE, depthshade=False, zorder=10)
    legend = f"red: {int(bad.sum())} bad tets; blue crosses: the worst place of each limit"
    figure.text(0.5, 0.03, legend, ha="center")
    lines = [textwrap.shorten(text, _MOST_TEXT, placeholder="...") for text in texts]
    figure.suptitle("\n".join(lines), fontsize=9, y=0.99, va="top")
    figure.subplots_adjust(0.01, 0.09, 0.95, 0.97 - 0.025 * len(lines), wspace=0.08)
    path = Path(folder) / "bad_mesh.png"
    write_by(path, lambda file: figure.savefig(file, format="png"))
    return path
