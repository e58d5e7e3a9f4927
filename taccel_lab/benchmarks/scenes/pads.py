# SPDX-License-Identifier: Apache-2.0
"""The 40 x 40 x 5.9 mm pad of a parallel gripper, published at two resolutions or made by us."""

from __future__ import annotations

import numpy as np

from taccel_lab.exporters.published_meshes import choose_source, mesh_folder
from taccel_lab.files.tet_file import read_tet_file
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.tet_mesh import boundary_faces

SIZE_M = (40e-3, 40e-3, 5.925e-3)
HELD_M = 2.9e-3
"""Depth below which the published pads are held: their back is in a tray."""
_FILES = {239: "single_sensor__pad_maxv_1e-07", 5215: "single_sensor__pad_maxv_1e-09"}
_CELLS = {239: (8, 8, 2), 5215: (24, 24, 7)}


def pad(nodes: int, source: str) -> tuple[TetMesh, str]:
    """A pad in the gel frame (contact face at z = 0, outward z) of about so many nodes, and where
    it is from."""
    name = _FILES[nodes]
    source = choose_source(source, f"pads/{name}.vtk", f"pads/{name}.npz")
    if source == "generated":
        return held_below(block_mesh(_CELLS[nodes], SIZE_M, jitter=0.15, seed=7), HELD_M), source
    folder = mesh_folder() / "pads"
    points, tets = read_tet_file(folder / f"{name}.vtk")
    masks = np.load(folder / f"{name}.npz")
    # The file's contact face looks to -z: half a turn about x.
    return label(points * [1, -1, -1], tets, masks["stick_mask"], masks["coat_mask"]), source


def label(nodes_m: np.ndarray, tets: np.ndarray, held: np.ndarray, touched: np.ndarray) -> TetMesh:
    """Bonded are faces among held nodes, in contact those among touched ones; the rest are sides.

    ``held``, ``touched``: bool, [node].
    """
    faces = boundary_faces(tets)
    region = np.full(len(faces), int(Region.SIDE))
    region[touched[faces].all(axis=1)] = int(Region.CONTACT)
    region[held[faces].all(axis=1)] = int(Region.BOND)
    return TetMesh(nodes_m, tets, faces, region)


def held_below(mesh: TetMesh, depth_m: float) -> TetMesh:
    """The same block, bonded on every face that lies deeper than that."""
    z = mesh.nodes_m[:, 2]
    return label(mesh.nodes_m, mesh.tets, z < z.max() - depth_m, z > z.max() - 1e-9)
