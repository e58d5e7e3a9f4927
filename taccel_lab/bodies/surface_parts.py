# SPDX-License-Identifier: Apache-2.0
"""Separate parts of a triangle surface, and whether it is closed."""

from __future__ import annotations

import numpy as np


def one_node_of_each_part(faces: np.ndarray) -> np.ndarray:
    """One node of each connected part of a surface with faces [n, 3]."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    used, compact = np.unique(faces, return_inverse=True)
    compact = compact.reshape(faces.shape)
    rows, columns = compact[:, [0, 1]].ravel(), compact[:, [1, 2]].ravel()
    links = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(used), len(used)))
    _, labels = connected_components(links, directed=False)
    return used[np.unique(labels, return_index=True)[1]]


def is_closed(faces: np.ndarray) -> bool:
    """Whether each edge of the faces [n, 3] belongs to two of them."""
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return bool((np.unique(pairs, axis=0, return_counts=True)[1] == 2).all())
