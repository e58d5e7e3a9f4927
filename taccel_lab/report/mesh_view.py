# SPDX-License-Identifier: Apache-2.0
"""A surface that a page's reader turns: its geometry as text, drawn by ``mesh_view.js``."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import Region
from taccel_lab.report.figures import REGION_COLORS

MOST_FACES = 16_000
"""Most triangles, 220 KB of text. A surface of more is drawn with fewer."""


@dataclass(frozen=True)
class MeshView:
    """A surface's nodes (int16), faces (uint16) and regions (uint8) in base64."""

    nodes: str
    faces: str
    regions: str
    colors: str
    """Hexadecimal colours by region's number, as JSON."""
    legend: tuple[tuple[str, str], ...]
    """Name and colour of each region that there is."""
    size_mm: tuple[float, float, float]
    drawn_faces: int
    faces_in_all: int


def mesh_view(nodes_m: np.ndarray, faces: np.ndarray, regions: np.ndarray) -> MeshView | None:
    """The view of a surface; of more than ``MOST_FACES`` triangles a coarser one, with the same
    borders between regions. None of no face, and of one that cannot be made coarse enough.

    Args:
        nodes_m: [node, 3] in metres; those of no face are left out.
        faces: [face, 3] into the nodes.
        regions: ``Region`` of each face.
    """
    faces_in_all = len(faces)
    if faces_in_all > MOST_FACES:
        nodes_m, faces, regions = _coarser(nodes_m, faces, regions)
    used, index = np.unique(faces, return_inverse=True)
    if not 0 < len(faces) <= MOST_FACES or len(used) > np.iinfo(np.uint16).max:
        return None
    points = np.asarray(nodes_m, dtype=np.float64)[used]
    low, high = points.min(axis=0), points.max(axis=0)
    half = max(float((high - low).max()) / 2, np.finfo(np.float64).tiny)
    quantised = np.rint((points - (low + high) / 2) / half * 32767).astype("<i2")
    present = [region for region in Region if (regions == int(region)).any()]
    colors = [REGION_COLORS[Region(i)] for i in range(max(map(int, Region)) + 1)]
    width, depth, height = (float(value) for value in (high - low) * 1e3)
    return MeshView(
        nodes=_text(quantised),
        faces=_text(index.reshape(-1, 3).astype("<u2")),
        regions=_text(np.asarray(regions).astype("u1")),
        colors=json.dumps(colors),
        legend=tuple((region.name.lower(), REGION_COLORS[region]) for region in present),
        size_mm=(width, depth, height),
        drawn_faces=len(faces),
        faces_in_all=faces_in_all,
    )


def _coarser(
    nodes_m: np.ndarray, faces: np.ndarray, regions: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes, faces and regions of about ``MOST_FACES`` triangles. Every region is decimated by
    itself (Schroeder et al. 1992) with its border kept, so that no gap opens between two."""
    import pyvista as pv

    reduction = 1.0 - 0.97 * MOST_FACES / len(faces)
    nodes, found, kinds, count = [], [], [], 0
    for region in np.unique(regions):
        used, index = np.unique(faces[regions == region], return_inverse=True)
        # Millimetres: VTK joins and judges points by absolute lengths.
        part = pv.PolyData.from_regular_faces(1e3 * np.asarray(nodes_m)[used], index.reshape(-1, 3))
        part = part.decimate_pro(
            reduction, preserve_topology=True, boundary_vertex_deletion=False, feature_angle=60
        )
        triangles = part.regular_faces
        nodes.append(1e-3 * np.asarray(part.points))
        found.append(triangles + count)
        kinds.append(np.full(len(triangles), region))
        count += part.n_points
    return np.concatenate(nodes), np.concatenate(found), np.concatenate(kinds)


def _text(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
