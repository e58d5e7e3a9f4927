# SPDX-License-Identifier: Apache-2.0
"""All dirty triangle surfaces (scans, STL files) come here: repaired and reported, or refused.

pymeshlab is GPL-3.0, so it is an extra, and this is the only module that loads it.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from taccel_lab.cad.mesh.surface import (
    check_closed,
    doubled_areas,
    enclosed_volume,
    least_thickness,
    weld,
)
from taccel_lab.errors import InputError
from taccel_lab.geometry.connectivity import compacted, piece_of_cells

_WELD_SHARE = 1e-6
"""Vertices closer than this share of the diagonal are one; an STL file rounds by a tenth of it."""
_MIN_THICKNESS_SHARE = 1e-3
"""Least thickness of a body over its diagonal: 0.03 mm of a pad of 30 mm."""
_MOST_CROSSING_SHARE = 0.05
"""Share of triangles that may be cut out where the surface passes through itself."""
_DEBRIS_SHARE = 0.01
"""Loose pieces with less than this share of the area are debris."""
_ROUNDS = 3


@dataclass(frozen=True)
class RepairedSurface:
    """A closed, outward surface and what was done to get there."""

    vertices: np.ndarray
    """float64, shape [n, 3], in the unit of the input."""
    triangles: np.ndarray
    """Outward (right-hand rule), int32, shape [m, 3]."""
    actions: tuple[str, ...]
    """What was changed, in the order it was done; empty for a clean surface."""


def repair_surface(
    vertices: np.ndarray, triangles: np.ndarray, *, max_hole_edges: int = 200
) -> RepairedSurface:
    """Make one closed, manifold, outward surface without self-intersections of any triangles.

    vertices, shape [n, 3], in any unit; triangles, shape [m, 3]. Triangles with NaN corners,
    degenerate, duplicate and non-manifold ones, small loose pieces and those where the surface
    passes through itself are cut out; holes of up to ``max_hole_edges`` edges are closed. Raises
    InputError for what cannot be repaired: no triangles, bigger holes, several bodies, a surface
    that crosses itself in more than 5 % of its triangles, regions without thickness.
    """
    pymeshlab = _load()
    actions: list[str] = []
    points, faces = _checked(vertices, triangles, actions)
    points, faces = _welded(points, faces, actions)
    try:
        points, faces = _manifold(pymeshlab, points, faces, actions)
        points, faces = _one_piece(points, faces, actions)
        before = len(faces)
        points, faces = _closed(pymeshlab, points, faces, max_hole_edges, actions)
        points, faces = _without_crossings(
            pymeshlab, points, faces, before, max_hole_edges, actions
        )
    except pymeshlab.PyMeshLabException as error:
        # A filter that finds no manifold surface, after those that make one.
        cause = str(error).partition("Details:")[2].strip() or str(error)
        raise InputError(f"pymeshlab cannot repair the surface: {cause}") from error
    check_closed(faces, "the repaired surface")
    if enclosed_volume(points[faces]) < 0:
        faces = faces[:, ::-1].copy()
        actions.append("turned the surface inside out, so that it faces outward")
    _check_thickness(points, faces)
    return RepairedSurface(points, faces, tuple(actions))


def self_intersections(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Triangles that pass through others, bool, shape [m]."""
    meshes = _mesh_set(_load(), vertices, triangles)
    meshes.compute_selection_by_self_intersections_per_face()
    return np.asarray(meshes.current_mesh().face_selection_array(), dtype=bool)


def _checked(
    vertices: np.ndarray, triangles: np.ndarray, actions: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(triangles, dtype=np.int32)
    shaped = points.ndim == 2 and faces.ndim == 2
    if not shaped or points.shape[1] != 3 or faces.shape[1] != 3 or not len(faces):
        raise InputError("a surface to repair needs vertices [n, 3] and triangles [m, 3]")
    if faces.max() >= len(points) or faces.min() < 0:
        raise InputError(
            f"the surface to repair has triangles of vertices {int(faces.min())} to "
            f"{int(faces.max())}, but {len(points)} vertices"
        )
    whole = np.isfinite(points[faces]).all(axis=(1, 2))
    if not whole.any():
        raise InputError("every triangle of the surface to repair has NaN or infinite corners")
    if not whole.all():
        actions.append(f"cut out {int((~whole).sum())} triangles with NaN or infinite corners")
    return _used(points, faces[whole])


def _welded(
    points: np.ndarray, faces: np.ndarray, actions: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    tolerance = _WELD_SHARE * float(np.linalg.norm(np.ptp(points, axis=0)))
    if tolerance <= 0:
        raise InputError("all triangles of the surface to repair lie in one point")
    merged, faces = weld(points, faces, tolerance)
    if len(merged) < len(points):
        actions.append(f"merged {len(points) - len(merged)} vertices of the same place")
    corners = merged[faces]
    cross = doubled_areas(corners)
    thin = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    thin |= np.linalg.norm(cross, axis=1) <= tolerance**2
    if thin.any():
        actions.append(f"cut out {int(thin.sum())} triangles without area")
    faces = faces[~thin]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    if len(first) < len(faces):
        actions.append(f"cut out {len(faces) - len(first)} duplicate triangles")
    if not len(first):
        raise InputError("no triangle of the surface to repair has an area")
    return _used(merged, faces[np.sort(first)])


def _manifold(
    pymeshlab: ModuleType, points: np.ndarray, faces: np.ndarray, actions: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    meshes = _mesh_set(pymeshlab, points, faces)
    edges = meshes.get_topological_measures()["non_two_manifold_edges"]
    if edges:
        meshes.meshing_repair_non_manifold_edges()
        actions.append(f"took apart {edges} edges that are not manifold")
    return _arrays(meshes)


def _one_piece(
    points: np.ndarray, faces: np.ndarray, actions: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """The largest connected piece without debris; several pieces of size are rejected."""
    piece = piece_of_cells(faces)
    areas = np.linalg.norm(doubled_areas(points[faces]), axis=1)
    shares = np.bincount(piece, areas) / areas.sum()
    large = np.flatnonzero(shares >= _DEBRIS_SHARE)
    if len(large) > 1:
        raise InputError(
            f"the surface to repair has {len(large)} separate pieces; one body is needed. Export "
            "the gel alone, or join the pieces in the program that they come from"
        )
    kept = piece == large[0]
    if not kept.all():
        pieces = int((shares > 0).sum()) - 1
        actions.append(f"cut out {pieces} loose pieces of {int((~kept).sum())} triangles")
    return _used(points, faces[kept])


def _closed(
    pymeshlab: ModuleType,
    points: np.ndarray,
    faces: np.ndarray,
    max_hole_edges: int,
    actions: list[str],
) -> tuple[np.ndarray, np.ndarray]:
    meshes = _mesh_set(pymeshlab, points, faces)
    measures = meshes.get_topological_measures()
    open_edges, corners = measures["boundary_edges"], measures["non_two_manifold_vertices"]
    if open_edges:
        # Lids that cross nothing where there are any, then the rest: crossings are sought later.
        meshes.meshing_close_holes(maxholesize=max_hole_edges, selfintersection=True)
        corners = meshes.get_topological_measures()["non_two_manifold_vertices"]
    if corners:
        meshes.meshing_repair_non_manifold_vertices()
        actions.append(f"took apart {corners} vertices that are not manifold")
    if meshes.get_topological_measures()["boundary_edges"]:
        meshes.meshing_close_holes(maxholesize=max_hole_edges, selfintersection=False)
    before = np.asarray(meshes.current_mesh().face_matrix())
    meshes.meshing_re_orient_faces_coherently()
    turned = int((np.asarray(meshes.current_mesh().face_matrix()) != before).any(axis=1).sum())
    if 0 < turned < len(before):
        actions.append(f"turned {turned} triangles the way of their neighbours")
    left = meshes.get_topological_measures()["boundary_edges"]
    if left:
        raise InputError(
            f"the repaired surface is not a closed manifold surface: {left} open edges are left, "
            f"at holes of more than {max_hole_edges} edges or with tangled borders; close them in "
            "your CAD program"
        )
    closed_points, closed = _arrays(meshes)
    if open_edges:
        lids = len(closed) - len(faces)
        actions.append(f"closed holes of {open_edges} edges with {lids} triangles")
    return closed_points, closed


def _without_crossings(
    pymeshlab: ModuleType,
    points: np.ndarray,
    faces: np.ndarray,
    triangle_count: int,
    max_hole_edges: int,
    actions: list[str],
) -> tuple[np.ndarray, np.ndarray]:
    """Cut out triangles that pass through others and close what opens, a few times."""
    for _ in range(_ROUNDS):
        crossing = self_intersections(points, faces)
        if not crossing.any():
            return points, faces
        if crossing.sum() > _MOST_CROSSING_SHARE * triangle_count:
            break
        actions.append(f"cut out {int(crossing.sum())} triangles that pass through others")
        points, faces = _used(points, faces[~crossing])
        points, faces = _manifold(pymeshlab, points, faces, actions)
        points, faces = _closed(pymeshlab, points, faces, max_hole_edges, actions)
    crossing = self_intersections(points, faces)
    if not crossing.any():
        return points, faces
    x, y, z = points[faces[crossing]].mean(axis=(0, 1))
    raise InputError(
        f"the surface passes through itself in {int(crossing.sum())} of {len(faces)} triangles "
        f"around x {x:.3g}, y {y:.3g}, z {z:.3g}; repair it in the program that it comes from"
    )


def _check_thickness(points: np.ndarray, faces: np.ndarray) -> None:
    least = _MIN_THICKNESS_SHARE * float(np.linalg.norm(np.ptp(points, axis=0)))
    thickness, (x, y, z) = least_thickness(points, faces)
    if thickness < least:
        raise InputError(
            f"the body is {thickness:.3g} thick at x {x:.3g}, y {y:.3g}, z {z:.3g}, in the unit of "
            f"the file; allowed: at least {least:.3g}. Thicken or remove the sheet"
        )


def _used(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used, packed = compacted(faces)
    return points[used], packed.astype(np.int32)


def _mesh_set(pymeshlab: ModuleType, points: np.ndarray, faces: np.ndarray) -> Any:
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(
        pymeshlab.Mesh(
            np.ascontiguousarray(points, dtype=np.float64),
            np.ascontiguousarray(faces, dtype=np.int32),
        )
    )
    return meshes


def _arrays(meshes: Any) -> tuple[np.ndarray, np.ndarray]:
    mesh = meshes.current_mesh()
    mesh.compact()
    points = np.asarray(mesh.vertex_matrix(), dtype=np.float64)
    return points, np.asarray(mesh.face_matrix(), dtype=np.int32)


def _load() -> ModuleType:
    try:
        import pymeshlab  # type: ignore[import-not-found]
    except ImportError as error:
        raise InputError(
            "repairing a surface needs pymeshlab (GPL-3.0), which is not installed: "
            'pip install "taccel-lab[repair]"'
        ) from error
    return pymeshlab
