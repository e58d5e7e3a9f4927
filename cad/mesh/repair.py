# SPDX-License-Identifier: Apache-2.0
"""Repair of triangle surfaces from elsewhere (scans, STL files) with pymeshlab.

pymeshlab is GPL-3.0, so it is an extra, and this is the only module that loads it.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np

from cad.mesh.surface import check_closed
from taccel_lab.errors import InputError


def repair_surface(
    vertices: np.ndarray, triangles: np.ndarray, *, max_hole_edges: int = 200
) -> tuple[np.ndarray, np.ndarray]:
    """Weld, remove duplicates and non-manifold parts, close holes and orient outward.

    vertices, shape [n, 3], in any unit; triangles, shape [m, 3]. Returns the repaired arrays
    (float64, int32). Raises InputError when the surface is still open.
    """
    pymeshlab = _load()
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles = np.ascontiguousarray(triangles, dtype=np.int32)
    if vertices.ndim != 2 or triangles.ndim != 2 or not len(triangles):
        raise InputError("a surface to repair needs vertices [n, 3] and triangles [m, 3]")
    if not np.isfinite(vertices).all() or triangles.max() >= len(vertices) or triangles.min() < 0:
        raise InputError("the surface to repair has NaN vertices or triangles without vertices")
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, triangles))
    meshes.meshing_merge_close_vertices()
    meshes.meshing_remove_duplicate_faces()
    meshes.meshing_remove_null_faces()
    meshes.meshing_remove_unreferenced_vertices()
    meshes.meshing_repair_non_manifold_edges()
    meshes.meshing_repair_non_manifold_vertices()
    meshes.meshing_close_holes(maxholesize=max_hole_edges)
    meshes.meshing_re_orient_faces_coherently()
    result = meshes.current_mesh()
    points = np.asarray(result.vertex_matrix(), dtype=np.float64)
    faces = np.asarray(result.face_matrix(), dtype=np.int32)
    check_closed(faces, "the repaired surface")
    corners = points[faces]
    if (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() < 0:
        faces = faces[:, ::-1].copy()
    return points, faces


def _load() -> ModuleType:
    try:
        import pymeshlab  # type: ignore[import-not-found]
    except ImportError as error:
        raise InputError(
            "repairing a surface needs pymeshlab (GPL-3.0), which is not installed: "
            'pip install "taccel-lab[repair]"'
        ) from error
    return pymeshlab
