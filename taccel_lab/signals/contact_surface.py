# SPDX-License-Identifier: Apache-2.0
"""Topology of the gel's contact surface: the part of the mesh that a tactile image shows.

Only this triangulation matters to height maps and normals, so it is cut out of the tet mesh once,
with compact node numbers, and reused for every frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh


@dataclass(frozen=True)
class ContactFaceMesh:
    """Triangulation of the contact faces with its neighbourhoods."""

    node_idx: np.ndarray
    """Tet-mesh node of each surface node, int32, shape [surface_node_count]."""
    faces: np.ndarray
    """Outward triangles in surface numbering, int32, shape [face_count, 3]."""
    edges: np.ndarray
    """Unique edges in surface numbering, int32, shape [edge_count, 2]."""
    ring_start: np.ndarray
    """First entry of each node in ``ring_nodes``, int32, shape [surface_node_count + 1]."""
    ring_nodes: np.ndarray
    """Edge neighbours of each node, int32, shape [2 edge_count]."""

    @property
    def node_count(self) -> int:
        return len(self.node_idx)

    @classmethod
    def from_mesh(cls, mesh: TetMesh | QuadraticMesh) -> ContactFaceMesh:
        """Cut the faces of region CONTACT out of ``mesh``; InputError when there is none."""
        faces = mesh.region_faces(Region.CONTACT)
        if len(faces) == 0:
            raise InputError(
                "TetMesh.face_regions holds no face of region CONTACT; a tactile image needs the "
                f"contact face (value {int(Region.CONTACT)}) to be labelled"
            )
        return cls.from_faces(faces)

    @classmethod
    def from_faces(cls, faces: np.ndarray) -> ContactFaceMesh:
        """Build from triangles in tet-mesh numbering, shape [face_count, 3]."""
        node_idx, local = np.unique(np.asarray(faces), return_inverse=True)
        local = local.reshape(-1, 3).astype(np.int32)
        edges = np.unique(
            np.sort(np.concatenate([local[:, [0, 1]], local[:, [1, 2]], local[:, [2, 0]]]), axis=1),
            axis=0,
        )
        ring_start, ring_nodes = _neighbours(edges, len(node_idx))
        return cls(
            node_idx=node_idx.astype(np.int32),
            faces=local,
            edges=edges.astype(np.int32),
            ring_start=ring_start,
            ring_nodes=ring_nodes,
        )


def _neighbours(edges: np.ndarray, node_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours one edge away, as (start, nodes)."""
    from scipy import sparse

    ones = np.ones(len(edges), dtype=np.int32)
    half = sparse.coo_array((ones, (edges[:, 0], edges[:, 1])), shape=(node_count, node_count))
    ring = sparse.csr_array(half + half.T)
    ring.sort_indices()
    return ring.indptr.astype(np.int32), ring.indices.astype(np.int32)
