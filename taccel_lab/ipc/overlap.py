# SPDX-License-Identifier: Apache-2.0
"""Crossings, containment and distances of triangle surfaces, in numpy, sharing no code with the
solver.

Crossings are found from the signs of tet volumes, containment from the winding number
[Van Oosterom and Strackee 1983, The Solid Angle of a Plane Triangle].
"""

from __future__ import annotations

import numpy as np


def component_nodes(faces: np.ndarray) -> np.ndarray:
    """One node of each connected component of a surface."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    used, compact = np.unique(faces, return_inverse=True)
    compact = compact.reshape(faces.shape)
    rows, columns = compact[:, [0, 1]].ravel(), compact[:, [1, 2]].ravel()
    links = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(used), len(used)))
    _, labels = connected_components(links, directed=False)
    return used[np.unique(labels, return_index=True)[1]]


def is_closed(faces: np.ndarray) -> bool:
    """Whether each edge belongs to two faces."""
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return bool((np.unique(pairs, axis=0, return_counts=True)[1] == 2).all())


def is_inside(point: np.ndarray, triangles: np.ndarray) -> bool:
    """Winding number of a closed surface, triangles [n, 3, 3], of either orientation."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return bool(abs(angle.sum()) > 2 * np.pi)


def crossings(edges: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of an edge [n, 2, 3] and a triangle [m, 3, 3] that it passes through: their indices."""
    edge, face = _overlapping_boxes(edges, triangles)
    p, q = edges[edge, 0], edges[edge, 1]
    a, b, c = (triangles[face, k] for k in range(3))
    above, below = _volume(a, b, c, p), _volume(a, b, c, q)
    sides = np.stack([_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)])
    hit = (above * below <= 0) & ((above != 0) | (below != 0))
    hit &= (sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)
    return edge[hit], face[hit]


def _volume(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Six times the signed volume of tets, shape [n]."""
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)


def _overlapping_boxes(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index pairs of primitives [n, corners, 3] whose bounding boxes overlap."""
    low_a, high_a = first.min(axis=1), first.max(axis=1)
    low_b, high_b = second.min(axis=1), second.max(axis=1)
    low, high = low_b.min(axis=0), high_b.max(axis=0)
    kept = np.flatnonzero(((low_a <= high) & (high_a >= low)).all(axis=1))
    # Sorted by their lower x, the boxes that can overlap one in x are a contiguous range.
    order = np.argsort(low_b[:, 0], kind="stable")
    starts = low_b[order, 0]
    width = float((high_b[:, 0] - low_b[:, 0]).max(initial=0.0))
    begin = np.searchsorted(starts, low_a[kept, 0] - width, side="left")
    end = np.searchsorted(starts, high_a[kept, 0], side="right")
    count = end - begin
    a = np.repeat(kept, count)
    within = np.arange(len(a)) - np.repeat(np.cumsum(count) - count, count)
    b = order[np.repeat(begin, count) + within]
    overlap = ((low_a[a] <= high_b[b]) & (high_a[a] >= low_b[b])).all(axis=1)
    return a[overlap], b[overlap]


def point_face_distances(point: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance of one point [3] from triangles [n, 3, 3] [m], shape [n]."""
    corners = np.moveaxis(triangles - point, 1, 0)
    best = np.full(len(triangles), np.inf)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    over = np.ones(len(triangles), dtype=bool)
    for k in range(3):
        a, b = corners[k], corners[(k + 1) % 3]
        edge = b - a
        t = np.clip(-(a * edge).sum(1) / (edge * edge).sum(1), 0, 1)
        best = np.minimum(best, np.linalg.norm(a + t[:, None] * edge, axis=1))
        over &= (np.cross(edge, -a) * normal).sum(1) >= 0
    height = np.abs((corners[0] * normal).sum(1)) / np.linalg.norm(normal, axis=1)
    return np.where(over, np.minimum(best, height), best)
