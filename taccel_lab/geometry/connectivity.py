# SPDX-License-Identifier: Apache-2.0
"""Connected pieces of meshes, and meshes without unused points."""

from __future__ import annotations

import numpy as np


def compacted(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes that cells [n, k] use, ascending, and the cells in their numbering, [n, k]."""
    used, packed = np.unique(cells, return_inverse=True)
    return used, packed.reshape(np.shape(cells))


def pieces_of_pairs(pairs: np.ndarray, count: int) -> np.ndarray:
    """Connected piece of each of ``count`` nodes that pairs [n, 2] join: 0, 1, ..., [count].

    Pieces are numbered by their first node.
    """
    first_of = np.arange(count)
    while len(pairs):
        pairs = np.sort(first_of[pairs], axis=1)
        pairs = pairs[pairs[:, 0] < pairs[:, 1]]
        np.minimum.at(first_of, pairs[:, 1], pairs[:, 0])
        while ((nearer := first_of[first_of]) != first_of).any():
            first_of = nearer
    return np.unique(first_of, return_inverse=True)[1]


def piece_of_nodes(cells: np.ndarray, node_count: int) -> np.ndarray:
    """Connected piece of each node of a mesh with cells [n, k], [node_count]; an unused node is a
    piece alone."""
    spokes = [cells[:, [0, k]] for k in range(1, cells.shape[1])]
    return pieces_of_pairs(np.concatenate(spokes), node_count)


def piece_of_cells(cells: np.ndarray) -> np.ndarray:
    """Connected piece of each cell [n, k]: 0, 1, ..., [n]; cells that share a node are joined."""
    used, packed = compacted(cells)
    return piece_of_nodes(packed, len(used))[packed[:, 0]]
