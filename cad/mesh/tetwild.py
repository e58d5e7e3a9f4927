# SPDX-License-Identifier: Apache-2.0
"""One run of fTetWild (Hu et al., ACM TOG 39 (2020) 117:1) made into a labelled mesh.

fTetWild keeps its surface within epsilon of the input, not on it. Glued nodes are put exactly on
the glued surface afterwards, tets that go flat there are dropped, and inner nodes move until the
worst tets are round enough.
"""

from __future__ import annotations

import tempfile
from contextlib import chdir
from dataclasses import dataclass

import numpy as np

from taccel_lab.cad.mesh.closest import ClosestPoint, Projection
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.mesh.tet_smoothing import improve_worst_tets
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.connectivity import compacted
from taccel_lab.geometry.tet_mesh import boundary_faces, tet_volumes

# Below 10 fTetWild often does not finish.
_STOP_ENERGY = 10.0
_MARGIN_DEG = 1.0
_POWERS = (4, 4, 8, 16, 32)
_FLAT_MM3 = 1e-7
_MIN_COSINE = 0.5


@dataclass(frozen=True)
class TetWildInput:
    """What fTetWild is to mesh."""

    surface: LabelledSurface
    """Closed labelled boundary."""
    inner_mm: np.ndarray
    """Triangles inside, between layers, as points [mm], shape [n, 3, 3]; none for one layer."""
    project: Projection
    """Projects onto the glued surface."""


def run_tetwild(
    given: TetWildInput, edge_mm: float, epsilon: float, *, wanted_deg: float
) -> TetMesh:
    """One mesh with tets of about ``edge_mm`` whose surface keeps within epsilon x diagonal."""
    nodes, tets = _tetrahedralize(given, edge_mm, epsilon)
    faces = boundary_faces(tets)
    regions = transfer_regions(nodes, faces, given.surface)
    for _ in range(_PEELS):
        glued = np.unique(faces[np.isin(regions, [Region.BOND, Region.WINDOW])])
        nodes[glued] = given.project(nodes[glued])
        # The glued surface comes out wavy; a tet whose corners all lie on it goes flat.
        volumes = tet_volumes(nodes, tets)
        flat = np.isin(tets, glued).all(axis=1) & (volumes < _FLAT_MM3)
        if not flat.any():
            break
        used, tets = compacted(tets[~flat])
        nodes = nodes[used]
        faces = boundary_faces(tets)
        regions = transfer_regions(nodes, faces, given.surface)
    inner = np.setdiff1d(np.arange(len(nodes)), faces)
    if len(given.inner_mm):
        inner = inner[~_on_triangles(nodes[inner], given.inner_mm, 2 * _epsilon_mm(given, epsilon))]
    wanted_deg += _MARGIN_DEG
    nodes = improve_worst_tets(nodes, tets, inner, wanted_deg=wanted_deg, powers=_POWERS)
    if not (tet_volumes(nodes, tets) > 0).all():
        raise InputError("putting the glued nodes on their surface turned tets inside out")
    return TetMesh(nodes_m=nodes * 1e-3, tets=tets, faces=faces, face_regions=regions)


_PEELS = 4
"""Times that tets are dropped from the glued surface."""


def _tetrahedralize(
    given: TetWildInput, edge_mm: float, epsilon: float
) -> tuple[np.ndarray, np.ndarray]:
    from pytetwild.pytetwild import tetrahedralize

    inner = np.asarray(given.inner_mm, dtype=np.float64).reshape(-1, 3)
    first = len(given.surface.vertices_mm)
    vertices = np.concatenate([given.surface.vertices_mm, inner])
    extra = first + np.arange(len(inner)).reshape(-1, 3)
    triangles = np.concatenate([given.surface.triangles, extra]).astype(np.int32)
    # fTetWild writes a tracking file into the working folder.
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        nodes, tets = tetrahedralize(
            vertices,
            triangles,
            edge_length_abs=edge_mm,
            epsilon=epsilon,
            stop_energy=_STOP_ENERGY,
            simplify=False,
            num_threads=1,
            vtk_ordering=True,
            quiet=True,
        )
    if not len(tets):
        raise InputError(
            "fTetWild found no inside; repair the surface in the program that it comes from"
        )
    return np.asarray(nodes, dtype=np.float64), np.asarray(tets, dtype=np.int64)


def _epsilon_mm(given: TetWildInput, epsilon: float) -> float:
    return epsilon * float(np.linalg.norm(np.ptp(given.surface.vertices_mm, axis=0)))


def _on_triangles(points: np.ndarray, triangles_mm: np.ndarray, within_mm: float) -> np.ndarray:
    corners = triangles_mm.reshape(-1, 3)
    distance, _ = ClosestPoint(corners, np.arange(len(corners)).reshape(-1, 3))(points)
    return distance < within_mm


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
