# SPDX-License-Identifier: Apache-2.0
"""A picture of a labelled mesh, drawn with matplotlib so that it needs neither display nor GPU."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.cad.export import REGION_COLORS
from taccel_lab.cad.mesh.surface import doubled_areas
from taccel_lab.geometry import Region, TetMesh

_VIEWS = (("contact face", 32.0, -58.0), ("glued back", -32.0, -58.0))
_LIGHT = np.array([0.35, -0.45, 0.82])


def write_preview(mesh: TetMesh, path: Path, *, title: str = "") -> None:
    """Draw the boundary of ``mesh`` from the front and the back, coloured by region."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    nodes = mesh.nodes_m * 1e3
    corners = nodes[mesh.faces]
    normals = doubled_areas(corners)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    base = np.array([REGION_COLORS[Region(int(r))] for r in mesh.face_regions])
    low, high = nodes.min(axis=0), nodes.max(axis=0)

    figure = Figure(figsize=(12, 5), dpi=110)
    FigureCanvasAgg(figure)
    for k, (name, elevation, azimuth) in enumerate(_VIEWS):
        axes = figure.add_subplot(1, 2, k + 1, projection="3d")
        light = _LIGHT * np.array([1, 1, np.sign(elevation)])
        shade = 0.62 + 0.38 * np.clip(normals @ light, 0, 1)
        faces = Poly3DCollection(
            list(corners), facecolors=base * shade[:, None], edgecolors="0.15", linewidths=0.25
        )
        axes.add_collection3d(faces)
        axes.set(
            xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]),
            xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]",
            title=name, zticks=np.round([low[2], high[2]], 2),
        )  # fmt: skip
        axes.set_box_aspect(high - low)
        axes.view_init(elev=elevation, azim=azimuth)
    figure.subplots_adjust(left=0.01, right=0.96, bottom=0.04, top=0.88, wspace=0.06)
    handles = [Patch(facecolor=REGION_COLORS[r], label=r.name.lower()) for r in Region]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False)
    figure.suptitle(title)
    figure.savefig(path, format="png")
