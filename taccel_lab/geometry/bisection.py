# SPDX-License-Identifier: Apache-2.0
"""Finer tets where they are requested, of any mesh: bisection at longest edges.

Tets that are too large are cut at the middle of their longest edge, and so is whatever shares that
edge, after its own longest edge has been cut (M. C. Rivara, "Local modification of meshes for
adaptive and/or multigrid finite-element methods", J. Comput. Appl. Math. 36 (1991) 79-89): the mesh
stays conforming and its angles stay bounded. New nodes of the surface lie on its triangles, so the
shape is that of the mesh, not of what the mesh was made from.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry.tet_mesh import TetMesh

Sizes = Callable[[np.ndarray], np.ndarray]
"""Wanted edge length [m] at points [m], [n, 3] -> [n]."""

_TET_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
_TRIANGLE_EDGES = np.array([[0, 1], [0, 2], [1, 2]])
_MOST_ROUNDS = 60


def bisected(mesh: TetMesh, size_m: Sizes, most_tets: int = 200_000) -> TetMesh:
    """The mesh with every tet cut until its longest edge is at most the size at its middle.

    Raises InputError where that takes more than ``most_tets``.
    """
    parts = _Parts(mesh)
    for _ in range(_MOST_ROUNDS):
        lengths, edges = parts.lengths_and_edges()
        middles = parts.nodes[parts.tets].mean(axis=1)
        longest = lengths.max(axis=1)
        if not (longest > size_m(middles)).any():
            return parts.mesh()
        parts.cut(lengths, edges, longest > size_m(middles))
        if len(parts.tets) > most_tets:
            break
    raise InputError(
        f"the mesh would need more than {most_tets:,} tets for elements as fine as that; take a "
        "coarser accuracy, or a larger contact"
    )


class _Parts:
    """A mesh under way."""

    def __init__(self, mesh: TetMesh) -> None:
        self.nodes = mesh.nodes_m
        self.tets, self.layers = mesh.tets.astype(np.int64), mesh.tet_layers
        self.faces, self.regions = mesh.faces.astype(np.int64), mesh.face_regions

    def mesh(self) -> TetMesh:
        return TetMesh(self.nodes, self.tets, self.faces, self.regions, self.layers)

    def _ids(self, corners: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """One number for each edge, whoever asks, [n, edges]."""
        ends = np.sort(corners[:, pairs], axis=-1)
        return ends[..., 0] * len(self.nodes) + ends[..., 1]

    def lengths_and_edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Lengths [m] and ids of the edges of the tets, [tet_count, 6]."""
        ends = self.nodes[self.tets[:, _TET_EDGES]]
        return np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=-1), self._ids(
            self.tets, _TET_EDGES
        )

    def cut(self, lengths: np.ndarray, edges: np.ndarray, large: np.ndarray) -> None:
        """Cut the longest edges of the tets of a mask, and of all that share those."""
        # Equal lengths are ordered by the edge, so that neighbours agree which is the longest.
        order = np.lexsort((edges, lengths), axis=1)
        longest = np.take_along_axis(edges, order[:, -1:], axis=1)[:, 0]
        marked = np.unique(longest[large])
        while True:
            touched = np.isin(edges, marked).any(axis=1)
            more = np.unique(np.concatenate([marked, longest[touched]]))
            if len(more) == len(marked):
                break
            marked = more
        count = len(self.nodes)
        ends = np.stack([marked // count, marked % count], axis=1)
        span = np.linalg.norm(self.nodes[ends[:, 0]] - self.nodes[ends[:, 1]], axis=1)
        # Longest first, for tets and faces alike: what two share is cut in the same order.
        ranks = np.lexsort((marked, span))[::-1]
        marked, ends = marked[ranks], ends[ranks]
        middles = self.nodes[ends].mean(axis=1)
        news = count + np.arange(len(marked))
        self.tets, (self.layers,) = _split(self.tets, [self.layers], count, marked, news)
        self.faces, (self.regions,) = _split(self.faces, [self.regions], count, marked, news)
        self.nodes = np.concatenate([self.nodes, middles])


def _split(
    cells: np.ndarray, labels: list[np.ndarray], count: int, marked: np.ndarray, news: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Cut simplices, [n, k], at their marked edges, the first of ``marked`` first, until none of
    theirs is marked; orientation stays. ``count``: nodes before; ``news``: middles of the edges."""
    pairs = _TET_EDGES if cells.shape[1] == 4 else _TRIANGLE_EDGES
    by_id = np.argsort(marked)
    while True:
        ends = np.sort(cells[:, pairs], axis=-1)
        old = (ends < count).all(axis=-1)
        ids = np.where(old, ends[..., 0] * count + ends[..., 1], -1)
        at = np.minimum(np.searchsorted(marked[by_id], ids), len(marked) - 1)
        rank = np.where(marked[by_id][at] == ids, by_id[at], len(marked))
        edge = rank.argmin(axis=1)
        first = rank[np.arange(len(cells)), edge]
        hit = np.flatnonzero(first < len(marked))
        if len(hit) == 0:
            return cells, labels
        twin = cells[hit].copy()
        cells = cells.copy()
        row = np.arange(len(hit))
        cells[hit, pairs[edge[hit], 0]] = news[first[hit]]
        twin[row, pairs[edge[hit], 1]] = news[first[hit]]
        cells = np.concatenate([cells, twin])
        labels = [np.concatenate([label, label[hit]]) for label in labels]
