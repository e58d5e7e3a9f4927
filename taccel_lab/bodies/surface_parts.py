# SPDX-License-Identifier: Apache-2.0
"""Separate parts of a triangle surface, and whether it is closed."""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry.connectivity import compacted, piece_of_nodes


def one_node_of_each_part(faces: np.ndarray) -> np.ndarray:
    """One node of each connected part of a surface with faces [n, 3]."""
    used, packed = compacted(faces)
    labels = piece_of_nodes(packed, len(used))
    return used[np.unique(labels, return_index=True)[1]]


def is_closed(faces: np.ndarray) -> bool:
    """Whether each edge of the faces [n, 3] belongs to two of them."""
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return bool((np.unique(pairs, axis=0, return_counts=True)[1] == 2).all())
