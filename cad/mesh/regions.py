# SPDX-License-Identifier: Apache-2.0
"""Regions of a free-form mesh: each boundary face takes the label of the CAD face it lies on."""

from __future__ import annotations

import numpy as np

from taccel_lab.cad.mesh.closest import ClosestPoint
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.geometry import Region

_MIN_COSINE = 0.5


def transfer_regions(
    nodes_mm: np.ndarray, faces: np.ndarray, surface: LabelledSurface
) -> np.ndarray:
    """``Region`` of each face, int32, shape [face_count].

    Only CAD triangles facing the same way as a mesh face may label it: near an edge of the pad the
    nearest triangle alone would often be one of the neighbouring face.
    """
    mesh = LabelledSurface(nodes_mm, faces, np.zeros(len(faces), dtype=np.int32))
    normals, centers = mesh.normals(), nodes_mm[faces].mean(axis=1)
    cad_normals = surface.normals()
    best = np.full(len(faces), np.inf)
    regions = np.full(len(faces), int(Region.SIDE), dtype=np.int32)
    # Glued faces first: where they meet others, facing their way decides.
    for group in (
        (Region.BOND, Region.WINDOW),
        (Region.CONTACT,),
        (Region.SIDE,),
    ):
        chosen = np.flatnonzero(np.isin(surface.regions, [int(r) for r in group]))
        if not len(chosen):
            continue
        distance, cell = ClosestPoint(surface.vertices_mm, surface.triangles[chosen])(centers)
        agree = (normals * cad_normals[chosen[cell]]).sum(axis=1)
        # A face that leans away from the CAD face pays for it with its own size.
        size = np.sqrt(mesh.areas_mm2())
        cost = distance + np.where(agree < _MIN_COSINE, 10.0, 1 - agree) * size
        better = cost < best
        best[better] = cost[better]
        regions[better] = surface.regions[chosen[cell]][better]
    return regions
