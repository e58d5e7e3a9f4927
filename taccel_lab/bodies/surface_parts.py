# SPDX-License-Identifier: Apache-2.0
"""Separate parts of a triangle surface: whether they are closed, and which side is outside."""

from __future__ import annotations

import numpy as np

from taccel_lab.bodies.mass_properties import winding_number
from taccel_lab.geometry.connectivity import compacted, piece_of_cells, piece_of_nodes


def one_node_of_each_part(faces: np.ndarray) -> np.ndarray:
    """One node of each connected part of a surface with faces [n, 3]."""
    used, packed = compacted(faces)
    labels = piece_of_nodes(packed, len(used))
    return used[np.unique(labels, return_index=True)[1]]


def is_closed(faces: np.ndarray) -> bool:
    """Whether each edge of the faces [n, 3] belongs to two of them."""
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return bool((np.unique(pairs, axis=0, return_counts=True)[1] == 2).all())


def turned_outward(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Turn the parts of a closed surface whose faces look inwards.

    ``points`` [n, 3] and ``faces`` [m, 3], each part oriented in itself. Returns the faces and how
    many parts were turned. A part inside an odd number of others bounds a cavity: it looks inwards
    where any other part had to be turned, and is left as it is where none had.
    """
    parts = piece_of_cells(faces)
    corners = points[faces]
    apart = [corners[parts == k] for k in range(int(parts.max()) + 1)]
    low = np.array([part.min(axis=(0, 1)) for part in apart])
    high = np.array([part.max(axis=(0, 1)) for part in apart])
    inwards, cavity = np.zeros(len(apart), dtype=bool), np.zeros(len(apart), dtype=bool)
    for k, own in enumerate(apart):
        at = own[0, 0]
        around = np.flatnonzero(((low <= at) & (high >= at)).all(axis=1))
        inside = [j for j in around if j != k and abs(winding_number(at, apart[j])) > 0.5]
        cavity[k] = len(inside) % 2 == 1
        a, b, c = (own - own.mean(axis=(0, 1))).transpose(1, 0, 2)
        inwards[k] = np.einsum("fi,fi->", a, np.cross(b, c)) < 0
    if not (inwards & ~cavity).any():
        return faces, 0
    turned = inwards != cavity
    return np.where(turned[parts][:, None], faces[:, [0, 2, 1]], faces), int(turned.sum())
