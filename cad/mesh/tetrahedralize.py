# SPDX-License-Identifier: Apache-2.0
"""Free-form tet mesh of a pad with fTetWild (Hu et al., ACM TOG 39 (2020) 117:1), cached.

fTetWild gives another mesh on every run, so a mesh is kept by the hash of its geometry and options.
"""

from __future__ import annotations

import tempfile
from contextlib import chdir

import numpy as np

from cad.mesh.cache import cached_mesh
from cad.mesh.regions import transfer_regions
from cad.mesh.surface import LabelledSurface
from cad.mesh.tessellate import tessellate_solid
from cad.parts.gel_pad import GelPad
from cad.parts.gel_pad_solid import gel_pad_solid
from cad.parts.labelled_solid import LabelledSolid
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces

# Below 10 fTetWild often does not finish.
_STOP_ENERGY = 10.0


def tetwild_gel_mesh(
    pad: GelPad,
    edge_mm: float = 1.0,
    *,
    epsilon: float = 5e-4,
    part: LabelledSolid | None = None,
    use_cache: bool = True,
) -> TetMesh:
    """Mesh ``pad`` with tets of about ``edge_mm``; its surface keeps within epsilon x diagonal.

    ``part`` is the solid of the pad if it is already at hand. Regions come from the CAD faces, and
    nodes of the glued back are put exactly on its plane.
    """
    smallest, largest = 0.2, pad.thickness_mm
    if not smallest <= edge_mm <= largest:
        raise InputError(
            f"edge_mm = {edge_mm:g} is not allowed; use {smallest:g} to {largest:g} mm (the pad's "
            "thickness)"
        )
    if not 1e-4 <= epsilon <= 1e-2:
        raise InputError(f"epsilon = {epsilon:g} is not allowed; use 1e-4 to 1e-2")
    # A finer input triples fTetWild's time and gains 0.04 % of volume.
    surface = tessellate_solid(part or gel_pad_solid(pad), tolerance_mm=0.01, angle_rad=0.1)
    if not use_cache:
        return _mesh(pad, surface, edge_mm, epsilon)
    recipe = {
        "mesher": "tetwild-2",
        "vertices": surface.vertices_mm.round(6),
        "triangles": surface.triangles,
        "regions": surface.regions,
        "edge_mm": edge_mm,
        "epsilon": epsilon,
    }
    return cached_mesh(recipe, lambda: _mesh(pad, surface, edge_mm, epsilon))


def _mesh(pad: GelPad, surface: LabelledSurface, edge_mm: float, epsilon: float) -> TetMesh:
    from pytetwild.pytetwild import tetrahedralize

    # fTetWild writes a tracking file into the working folder.
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        nodes, tets = tetrahedralize(
            surface.vertices_mm,
            surface.triangles,
            edge_length_abs=edge_mm,
            epsilon=epsilon,
            stop_energy=_STOP_ENERGY,
            simplify=False,
            num_threads=1,
            vtk_ordering=True,
            quiet=True,
        )
    nodes, tets = np.asarray(nodes, dtype=np.float64), np.asarray(tets, dtype=np.int64)
    faces = boundary_faces(tets)
    regions = transfer_regions(nodes, faces, surface)
    back = np.unique(faces[np.isin(regions, [Region.BOND, Region.WINDOW])])
    nodes[back, 2] = -pad.thickness_mm
    # fTetWild leaves the back wavy within epsilon; a tet whose corners all lie on it goes flat.
    flat = np.isin(tets, back).all(axis=1)
    if flat.any():
        nodes, tets = _without_unused(nodes, tets[~flat])
        faces = boundary_faces(tets)
        regions = transfer_regions(nodes, faces, surface)
    return TetMesh(nodes_m=nodes * 1e-3, tets=tets, faces=faces, face_regions=regions)


def _without_unused(nodes: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used, packed = np.unique(tets, return_inverse=True)
    return nodes[used], packed.reshape(tets.shape)
