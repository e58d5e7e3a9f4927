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
    surface = _Surface(_load(), vertices, triangles, max_hole_edges)
    surface.weld()
    try:
        surface.make_manifold()
        surface.keep_one_piece()
        before = len(surface.faces)
        surface.close()
        surface.cut_crossings(before)
    except surface.pymeshlab.PyMeshLabException as error:
        # A filter that finds no manifold surface, after those that make one.
        cause = str(error).partition("Details:")[2].strip() or str(error)
        raise InputError(f"pymeshlab cannot repair the surface: {cause}") from error
    surface.face_outward()
    return RepairedSurface(surface.points, surface.faces, tuple(surface.actions))


def self_intersections(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Triangles that pass through others, bool, shape [m]."""
    meshes = _mesh_set(_load(), vertices, triangles)
    meshes.compute_selection_by_self_intersections_per_face()
    return np.asarray(meshes.current_mesh().face_selection_array(), dtype=bool)


class _Surface:
    """Triangles while they are repaired, and what was done to them."""

    def __init__(
        self,
        pymeshlab: ModuleType,
        vertices: np.ndarray,
        triangles: np.ndarray,
        max_hole_edges: int,
    ) -> None:
        self.pymeshlab, self.max_hole_edges = pymeshlab, max_hole_edges
        self.points = np.ascontiguousarray(vertices, dtype=np.float64)
        self.faces = np.ascontiguousarray(triangles, dtype=np.int32)
        self.actions: list[str] = []
        points, faces = self.points, self.faces
        shaped = points.ndim == 2 and faces.ndim == 2
        if not shaped or points.shape[1] != 3 or faces.shape[1] != 3 or not len(faces):
            raise InputError("a surface to repair needs vertices [n, 3] and triangles [m, 3]")
        if faces.max() >= len(points) or faces.min() < 0:
            raise InputError(
                f"the surface to repair has triangles of vertices {int(faces.min())} to "
                f"{int(faces.max())}, but {len(points)} vertices"
            )
        whole = np.asarray(np.isfinite(points[faces]).all(axis=(1, 2)))
        if not whole.any():
            raise InputError("every triangle of the surface to repair has NaN or infinite corners")
        if not whole.all():
            self._note(f"cut out {int((~whole).sum())} triangles with NaN or infinite corners")
        self._keep(whole)

    def weld(self) -> None:
        """Merge vertices of a place; drop triangles without area and those that are there twice."""
        tolerance = _WELD_SHARE * float(np.linalg.norm(np.ptp(self.points, axis=0)))
        if tolerance <= 0:
            raise InputError("all triangles of the surface to repair lie in one point")
        count = len(self.points)
        self.points, self.faces = weld(self.points, self.faces, tolerance)
        if len(self.points) < count:
            self._note(f"merged {count - len(self.points)} vertices of the same place")
        cross = doubled_areas(self.points[self.faces])
        thin = (self.faces == np.roll(self.faces, 1, axis=1)).any(axis=1)
        thin |= np.linalg.norm(cross, axis=1) <= tolerance**2
        if thin.any():
            self._note(f"cut out {int(thin.sum())} triangles without area")
        self.faces = self.faces[~thin]
        _, first = np.unique(np.sort(self.faces, axis=1), axis=0, return_index=True)
        if len(first) < len(self.faces):
            self._note(f"cut out {len(self.faces) - len(first)} duplicate triangles")
        if not len(first):
            raise InputError("no triangle of the surface to repair has an area")
        self._keep(np.sort(first))

    def make_manifold(self) -> None:
        """Take edges apart that more than two triangles share."""
        meshes = self._mesh_set()
        edges = meshes.get_topological_measures()["non_two_manifold_edges"]
        if edges:
            meshes.meshing_repair_non_manifold_edges()
            self._note(f"took apart {edges} edges that are not manifold")
        self._take(meshes)

    def keep_one_piece(self) -> None:
        """The largest connected piece without debris; several pieces of size are rejected."""
        piece = piece_of_cells(self.faces)
        areas = np.linalg.norm(doubled_areas(self.points[self.faces]), axis=1)
        shares = np.bincount(piece, areas) / areas.sum()
        large = np.flatnonzero(shares >= _DEBRIS_SHARE)
        if len(large) > 1:
            raise InputError(
                f"the surface to repair has {len(large)} separate pieces; one body is needed. "
                "Export the gel alone, or join the pieces in the program that they come from"
            )
        kept = np.asarray(piece == large[0])
        if not kept.all():
            pieces = int((shares > 0).sum()) - 1
            self._note(f"cut out {pieces} loose pieces of {int((~kept).sum())} triangles")
        self._keep(kept)

    def close(self) -> None:
        """Close holes, take vertices apart that are not manifold, turn triangles one way."""
        meshes = self._mesh_set()
        measures = meshes.get_topological_measures()
        open_edges, corners = measures["boundary_edges"], measures["non_two_manifold_vertices"]
        most = self.max_hole_edges
        if open_edges:
            # Lids that cross nothing where there are any, then the rest: crossings are sought
            # later.
            meshes.meshing_close_holes(maxholesize=most, selfintersection=True)
            corners = meshes.get_topological_measures()["non_two_manifold_vertices"]
        if corners:
            meshes.meshing_repair_non_manifold_vertices()
            self._note(f"took apart {corners} vertices that are not manifold")
        if meshes.get_topological_measures()["boundary_edges"]:
            meshes.meshing_close_holes(maxholesize=most, selfintersection=False)
        before = np.asarray(meshes.current_mesh().face_matrix())
        meshes.meshing_re_orient_faces_coherently()
        turned = int((np.asarray(meshes.current_mesh().face_matrix()) != before).any(axis=1).sum())
        if 0 < turned < len(before):
            self._note(f"turned {turned} triangles the way of their neighbours")
        left = meshes.get_topological_measures()["boundary_edges"]
        if left:
            raise InputError(
                f"the repaired surface is not a closed manifold surface: {left} open edges are "
                f"left, at holes of more than {most} edges or with tangled borders; close them in "
                "your CAD program"
            )
        count = len(self.faces)
        self._take(meshes)
        if open_edges:
            lids = len(self.faces) - count
            self._note(f"closed holes of {open_edges} edges with {lids} triangles")

    def cut_crossings(self, triangle_count: int) -> None:
        """Cut out triangles that pass through others and close what opens, a few times."""
        for _ in range(_ROUNDS):
            crossing = self_intersections(self.points, self.faces)
            if not crossing.any():
                return
            if crossing.sum() > _MOST_CROSSING_SHARE * triangle_count:
                break
            self._note(f"cut out {int(crossing.sum())} triangles that pass through others")
            self._keep(~crossing)
            self.make_manifold()
            self.close()
        crossing = self_intersections(self.points, self.faces)
        if not crossing.any():
            return
        x, y, z = self.points[self.faces[crossing]].mean(axis=(0, 1))
        raise InputError(
            f"the surface passes through itself in {int(crossing.sum())} of {len(self.faces)} "
            f"triangles around x {x:.3g}, y {y:.3g}, z {z:.3g}; repair it in the program that it "
            "comes from"
        )

    def face_outward(self) -> None:
        """Turn an inside-out surface; InputError for one that is open or too thin."""
        check_closed(self.faces, "the repaired surface")
        if enclosed_volume(self.points[self.faces]) < 0:
            self.faces = self.faces[:, ::-1].copy()
            self._note("turned the surface inside out, so that it faces outward")
        least = _MIN_THICKNESS_SHARE * float(np.linalg.norm(np.ptp(self.points, axis=0)))
        thickness, (x, y, z) = least_thickness(self.points, self.faces)
        if thickness < least:
            raise InputError(
                f"the body is {thickness:.3g} thick at x {x:.3g}, y {y:.3g}, z {z:.3g}, in the "
                f"unit of the file; allowed: at least {least:.3g}. Thicken or remove the sheet"
            )

    def _note(self, action: str) -> None:
        self.actions.append(action)

    def _keep(self, chosen: np.ndarray) -> None:
        used, packed = compacted(self.faces[chosen])
        self.points, self.faces = self.points[used], packed.astype(np.int32)

    def _mesh_set(self) -> Any:
        return _mesh_set(self.pymeshlab, self.points, self.faces)

    def _take(self, meshes: Any) -> None:
        mesh = meshes.current_mesh()
        mesh.compact()
        self.points = np.asarray(mesh.vertex_matrix(), dtype=np.float64)
        self.faces = np.asarray(mesh.face_matrix(), dtype=np.int32)


def _mesh_set(pymeshlab: ModuleType, points: np.ndarray, faces: np.ndarray) -> Any:
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(
        pymeshlab.Mesh(
            np.ascontiguousarray(points, dtype=np.float64),
            np.ascontiguousarray(faces, dtype=np.int32),
        )
    )
    return meshes


def _load() -> ModuleType:
    try:
        import pymeshlab  # type: ignore[import-not-found]
    except ImportError as error:
        raise InputError(
            "repairing a surface needs pymeshlab (GPL-3.0), which is not installed: "
            'pip install "taccel-lab[repair]"'
        ) from error
    return pymeshlab
