# SPDX-License-Identifier: Apache-2.0
"""A meshed gel made thicker or thinner: the glued surface moves along z, the tets follow.

The same as of ``cad.gel_import.thickness`` for a gel whose file is not at hand: contact face and
outline at the glue stay, upright walls become longer. Nodes between follow a harmonic share, 0 at
the contact face and 1 at the glue, so that the connectivity of all thicknesses is one.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import spsolve

from taccel_lab.cad.mesh.quality_measures import dihedral_angles_deg
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.tet_mesh import tet_volumes

_UPRIGHT = 0.1
"""Largest z of the normal of a wall that becomes longer; rounded and slanted ones keep their
shape."""
_LEAST_ANGLE_DEG = 5.0
"""Least dihedral angle of a moved tet: half of what new meshes must have, since stretched tets are
flatter than those that they come from."""


def moved_bond(mesh: TetMesh, down_mm: float) -> TetMesh:
    """The mesh with its glued surface ``down_mm`` lower, negative for a thinner gel.

    Raises:
        InputError: Tets would be flat or inside out.
    """
    glued = mesh.region_nodes(Region.BOND, Region.WINDOW)
    share = np.zeros(mesh.node_count)
    share[glued] = 1.0
    held = np.zeros(mesh.node_count, dtype=bool)
    held[glued] = held[mesh.region_nodes(Region.CONTACT)] = held[_leaning(mesh)] = True
    free = np.flatnonzero(~held)
    if len(free):
        stiffness = _laplacian(mesh)[free]
        share[free] = np.asarray(spsolve(stiffness[:, free].tocsc(), -(stiffness @ share)))
    nodes = mesh.nodes_m.copy()
    nodes[:, 2] -= 1e-3 * down_mm * share
    if tet_volumes(nodes, mesh.tets).min() <= 0:
        raise InputError("its glued surface would touch or cross the rest of the gel")
    least = float(dihedral_angles_deg(1e3 * nodes, mesh.tets).min())
    if least < _LEAST_ANGLE_DEG:
        raise InputError(
            f"its tets would have dihedral angles of {least:.1f} deg; at least "
            f"{_LEAST_ANGLE_DEG:g} deg are needed"
        )
    return TetMesh(nodes, mesh.tets, mesh.faces, mesh.face_regions, mesh.tet_layers)


def _leaning(mesh: TetMesh) -> np.ndarray:
    """Nodes of walls that are not upright."""
    walls = mesh.faces[mesh.face_regions == int(Region.SIDE)]
    a, b, c = np.moveaxis(mesh.nodes_m[walls], 1, 0)
    normal = np.cross(b - a, c - a)
    lean = np.abs(normal[:, 2]) > _UPRIGHT * np.linalg.norm(normal, axis=1)
    return np.unique(walls[lean])


def _laplacian(mesh: TetMesh) -> sparse.csr_matrix:
    """Stiffness of linear tets for a scalar of conductivity 1, [node, node]."""
    corners = mesh.nodes_m[mesh.tets]
    sides = corners[:, 1:] - corners[:, :1]
    inner = np.linalg.inv(sides).transpose(0, 2, 1)
    slopes = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    volume = np.abs(np.linalg.det(sides)) / 6
    blocks = volume[:, None, None] * (slopes @ slopes.transpose(0, 2, 1))
    rows = np.repeat(mesh.tets, 4, axis=1).ravel()
    columns = np.tile(mesh.tets, (1, 4)).ravel()
    size = (mesh.node_count, mesh.node_count)
    return sparse.csr_matrix((blocks.ravel(), (rows, columns)), shape=size)
