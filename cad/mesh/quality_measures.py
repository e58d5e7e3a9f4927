# SPDX-License-Identifier: Apache-2.0
"""Per-tet quality measures in plain numpy.

Dihedral angles from the face normals; mean ratio eta = 12 (3 V)^(2/3) / sum of squared edge lengths
(Liu and Joe, BIT 34 (1994) 268), which is 1 for the regular tet and 0 for a flat one.
"""

from __future__ import annotations

import numpy as np

TET_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Corners of each face of a tet, seen from outside."""
EDGE_PAIRS = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
_OPPOSITE = np.array([[2, 3], [1, 3], [1, 2], [0, 3], [0, 2], [0, 1]])


def dihedral_angles_deg(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Dihedral angle at each of the six edges [deg], shape [tet_count, 6], edges as EDGE_PAIRS."""
    p = nodes[tets]
    start = p[:, EDGE_PAIRS[:, 0]]
    edge = p[:, EDGE_PAIRS[:, 1]] - start
    edge = edge / np.linalg.norm(edge, axis=-1, keepdims=True)
    arms = []
    for k in range(2):
        arm = p[:, _OPPOSITE[:, k]] - start
        arms.append(arm - (arm * edge).sum(axis=-1, keepdims=True) * edge)
    sine = np.linalg.norm(np.cross(arms[0], arms[1]), axis=-1)
    cosine = (arms[0] * arms[1]).sum(axis=-1)
    return np.rad2deg(np.arctan2(sine, cosine))


def six_volumes(corners: np.ndarray) -> np.ndarray:
    """Six times the signed volumes of tets, [..., 4, 3] -> [...]."""
    return np.linalg.det(corners[..., 1:, :] - corners[..., :1, :])


def mean_ratios(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Mean ratio eta of each tet, signed like the volume, shape [tet_count]."""
    p = nodes[tets]
    volume = six_volumes(p) / 6
    edges = p[:, EDGE_PAIRS[:, 1]] - p[:, EDGE_PAIRS[:, 0]]
    total = (edges**2).sum(axis=(1, 2))
    return np.sign(volume) * 12 * (3 * np.abs(volume)) ** (2 / 3) / total
