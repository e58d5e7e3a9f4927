# SPDX-License-Identifier: Apache-2.0
"""A tet mesh with a node in the middle of each edge: ten-node tets with straight edges at rest.

Middle nodes come after the corner nodes, in the order of ``edges``. Within a tet they follow the
edges 01, 12, 02, 03, 13, 23, as in VTK's quadratic tetra.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry.tet_mesh import RegionFaces, TetMesh
from taccel_lab.typed import typed

TET_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""Ends of the middle nodes 4 to 9 of a tet."""

CORNER_MASS = 1.0 / 36.0
MIDDLE_MASS = 4.0 / 27.0
"""Shares of a tet's mass by node: the diagonal of the consistent matrix, scaled to the whole mass
[Hinton, Rock and Zienkiewicz 1976]. Row sums would make corner masses negative."""


@typed
@dataclass(frozen=True, repr=False)
class QuadraticMesh(RegionFaces):
    """Ten-node tets on a linear mesh; reads like a TetMesh where only nodes and faces matter."""

    base: TetMesh
    edges: np.ndarray
    """Ends of each middle node, ascending, int32, shape [edge_count, 2]."""
    tets: np.ndarray
    """Nodes, int32, shape [tet_count, 10]."""
    faces: np.ndarray
    """Each boundary triangle cut in four at its middle nodes, outward, int32,
    shape [4 base_face_count, 3]; those of base face i start at 4 i."""
    face_regions: np.ndarray
    """``Region`` of each face, int32, shape [4 base_face_count]."""

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """Return what ``repr`` shows."""
        title, rows = self.base.summary()
        return title, [("nodes", f"{self.node_count}, {self.tet_count} quadratic tets"), *rows[1:]]

    @property
    def nodes_m(self) -> np.ndarray:
        """Node positions [m], shape [node_count, 3]."""
        return self.with_middles(self.base.nodes_m)

    @property
    def node_count(self) -> int:
        return self.base.node_count + len(self.edges)

    @property
    def tet_count(self) -> int:
        return len(self.tets)

    def with_middles(self, corners: np.ndarray) -> np.ndarray:
        """Return values at all nodes of a field linear in each tet, [..., corner, k] -> [..., node,
        k]."""
        middles = 0.5 * (corners[..., self.edges[:, 0], :] + corners[..., self.edges[:, 1], :])
        return np.concatenate([corners, middles], axis=-2)

    def held_with(self, corners: np.ndarray) -> np.ndarray:
        """Return the sorted nodes held when these corners are. The middle of an edge is held with
        its ends where a whole boundary face or a whole tet is held around it.

        An edge whose two ends are held for other reasons (one from face to face across a
        thin layer, or two separate points) stays free to bend.
        """
        held = np.zeros(self.base.node_count, dtype=bool)
        held[corners] = True
        whole_faces = held[self.base.faces].all(axis=1)
        whole_tets = held[self.base.tets].all(axis=1)
        middles = np.concatenate(
            [
                self.faces.reshape(-1, 12)[whole_faces].ravel(),
                self.tets[whole_tets, 4:].ravel(),
            ]
        )
        return np.unique(np.concatenate([np.flatnonzero(held), middles]))

    def lumped_masses(self, tet_masses: np.ndarray) -> np.ndarray:
        """Positive nodal masses from the masses of the tets [kg], [tet_count] -> [node_count]."""
        shares = np.array([CORNER_MASS] * 4 + [MIDDLE_MASS] * 6)
        weights = np.outer(tet_masses, shares).ravel()
        return np.bincount(self.tets.ravel(), weights, minlength=self.node_count)


def quadratic_mesh(mesh: TetMesh) -> QuadraticMesh:
    """Add a node to the middle of each edge of ``mesh``."""
    count = mesh.node_count
    ends = np.sort(mesh.tets[:, TET_EDGES].reshape(-1, 2), axis=1)
    edges, inverse = np.unique(ends, axis=0, return_inverse=True)
    tets = np.concatenate([mesh.tets, count + inverse.reshape(-1, 6)], axis=1)

    keys = edges[:, 0].astype(np.int64) * count + edges[:, 1]

    def middle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        low, high = np.minimum(first, second), np.maximum(first, second)
        return count + np.searchsorted(keys, low.astype(np.int64) * count + high)

    a, b, c = mesh.faces.T
    ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
    parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    faces = np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3)
    return QuadraticMesh(
        base=mesh,
        edges=edges.astype(np.int32),
        tets=tets.astype(np.int32),
        faces=faces.astype(np.int32),
        face_regions=np.repeat(mesh.face_regions, 4),
    )
