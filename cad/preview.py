# SPDX-License-Identifier: Apache-2.0
"""Pictures of labelled surfaces, drawn with matplotlib: they need neither display nor GPU."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.cad.gel_import.importer import PartFaces
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.region_colors import REGION_COLORS
from taccel_lab.files.atomic_file import write_by
from taccel_lab.geometry import Region, TetMesh

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_VIEWS = (("contact face", 32.0, -58.0), ("glued back", -32.0, -58.0))
_AROUND = (("from above", 30.0, -55.0), ("from below, the other side", -30.0, 125.0))
_LIGHT = np.array([0.35, -0.45, 0.82])
_SEEN = 0.05
"""Cosine towards the eye from which on a face is drawn and numbered."""


def write_preview(mesh: TetMesh, path: Path, *, title: str = "") -> None:
    """Draw the boundary of ``mesh`` from the front and the back, coloured by region."""
    surface = LabelledSurface(mesh.nodes_m * 1e3, mesh.faces, mesh.face_regions)
    figure = _figure(title)
    for k, (name, elevation, azimuth) in enumerate(_VIEWS):
        axes = _axes(figure, k, surface.vertices_mm, name, elevation, azimuth)
        _add_faces(axes, surface, elevation, edgecolors="0.15", linewidths=0.25)
    write_by(path, lambda file: figure.savefig(file, format="png"))


def write_faces(
    faces: PartFaces,
    regions: Sequence[Region],
    window: np.ndarray | None,
    path: Path,
    *,
    title: str = "",
) -> None:
    """Draw the faces of a part with their numbers, in the frame of its file, coloured by what they
    are for; ``window`` are the corners of one that is split off, [4, 3]."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    of_face = np.array([int(region) for region in regions], dtype=np.int32)
    surface = LabelledSurface(faces.vertices, faces.triangles, of_face[faces.face_of])
    normals, areas = surface.normals(), surface.areas_mm2()
    corners = faces.vertices[faces.triangles]
    centers = corners.mean(axis=1)
    figure = _figure(title)
    for k, (name, elevation, azimuth) in enumerate(_AROUND):
        axes = _axes(figure, k, faces.vertices, name, elevation, azimuth, computed_zorder=False)
        up, around = np.radians([elevation, azimuth])
        eye = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
        seen = normals @ eye > _SEEN
        shown = LabelledSurface(faces.vertices, faces.triangles[seen], surface.regions[seen])
        _add_faces(axes, shown, elevation, linewidths=0.4)
        borders = _borders(faces.triangles[seen], faces.face_of[seen])
        lines = Line3DCollection(list(faces.vertices[borders]), colors="0.1", linewidths=0.8)
        axes.add_collection3d(lines)
        if window is not None and np.cross(window[1] - window[0], window[2] - window[0]) @ eye < 0:
            color = REGION_COLORS[Region.WINDOW]
            axes.add_collection3d(Poly3DCollection([window], facecolors=[color], edgecolors="0.1"))
        for info in faces.table:
            own = np.flatnonzero((faces.face_of == info.index) & seen)
            if not len(own) or areas[own].sum() < 0.25 * info.area_mm2:
                continue
            middle = (areas[own, None] * centers[own]).sum(axis=0) / areas[own].sum()
            at = centers[own[np.linalg.norm(centers[own] - middle, axis=1).argmin()]]
            place = middle if info.kind == "plane" else at
            axes.text(
                *place, str(info.index), fontsize=8, ha="center", va="center", zorder=20,
                bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "0.4", "lw": 0.5},
            )  # fmt: skip
    write_by(path, lambda file: figure.savefig(file, format="png"))


def _borders(triangles: np.ndarray, face_of: np.ndarray) -> np.ndarray:
    """Edges between triangles of two faces, and those of one triangle alone, [n, 2]."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, inverse = np.unique(sides, axis=0, return_inverse=True)
    inverse, owner = inverse.ravel(), np.repeat(face_of, 3)
    low, high = np.full(len(edges), owner.max()), np.zeros(len(edges), dtype=owner.dtype)
    np.minimum.at(low, inverse, owner)
    np.maximum.at(high, inverse, owner)
    return edges[(low != high) | (np.bincount(inverse) == 1)]


def _figure(title: str) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    figure = Figure(figsize=(12, 5), dpi=110)
    FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0.01, right=0.96, bottom=0.04, top=0.88, wspace=0.06)
    handles = [Patch(facecolor=REGION_COLORS[r], label=r.name.lower()) for r in Region]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False)
    figure.suptitle(title)
    return figure


def _axes(
    figure: Figure, column: int, points: np.ndarray, name: str, elevation: float, azimuth: float,
    **options: Any,
) -> Any:  # fmt: skip
    axes: Any = figure.add_subplot(1, 2, column + 1, projection="3d", **options)
    low, high = points.min(axis=0), points.max(axis=0)
    axes.set(
        xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]),
        xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]",
        title=name, zticks=np.round([low[2], high[2]], 2),
    )  # fmt: skip
    axes.set_box_aspect(high - low)
    axes.view_init(elev=elevation, azim=azimuth)
    return axes


def _add_faces(axes: Any, surface: LabelledSurface, elevation: float, **style: Any) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    light = _LIGHT * np.array([1, 1, np.sign(elevation)])
    shade = 0.62 + 0.38 * np.clip(surface.normals() @ light, 0, 1)
    base = np.array([REGION_COLORS[Region(int(r))] for r in surface.regions])
    colors, corners = base * shade[:, None], list(surface.vertices_mm[surface.triangles])
    style = {"edgecolors": colors, **style}
    axes.add_collection3d(Poly3DCollection(corners, facecolors=colors, **style))
