# SPDX-License-Identifier: Apache-2.0
"""Edges that pass through faces, and distances of points from faces, in numpy.

An edge crosses a face where its ends lie on either side of the face's plane and its line passes on
the same side of all three face edges, which signed volumes of tets tell. Volumes below the rounding
error of their products count as zero, and touching counts as crossing. Faces and edges that lie in
one plane are not told apart from those that do not touch; the edges of their neighbours give them
away.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.bodies.primitives import unique_edges


def self_crossings(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges (vertex, vertex) [n, 2] and the faces [n] of the same surface they pass through."""
    edges = unique_edges(faces).astype(np.int64)
    edge, face = crossing_pairs(vertices[edges], vertices[faces], edges, faces)
    return edges[edge], face


def crossing_pairs(
    segments: np.ndarray,
    triangles: np.ndarray,
    segment_nodes: np.ndarray | None = None,
    triangle_nodes: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Indices of segments [n, 2, 3] and the triangles [m, 3, 3] they pass through or touch.

    With node ids ([n, 2] and [m, 3]) given, pairs that share a node are left out.
    """
    from taccel_lab.bodies.box_pairs import box_pairs

    a, b = box_pairs(
        (segments.min(axis=1), segments.max(axis=1)), (triangles.min(axis=1), triangles.max(axis=1))
    )
    if segment_nodes is not None and triangle_nodes is not None:
        shared = (segment_nodes[a][:, :, None] == triangle_nodes[b][:, None, :]).any(axis=(1, 2))
        a, b = a[~shared], b[~shared]
    hit = segments_pierce(segments[a], triangles[b])
    return a[hit], b[hit]


def segments_pierce(segments: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Whether each segment [n, 2, 3] passes through its triangle [n, 3, 3], touching included."""
    if len(segments) == 0:
        return np.zeros(0, dtype=bool)
    p = segments[:, 0]
    q = segments[:, 1] - p
    a, b, c = (triangles[:, k] - p for k in range(3))
    reach = np.abs(np.concatenate([triangles - p[:, None], q[:, None]], axis=1)).max(axis=(1, 2))
    largest = np.maximum(np.abs(segments).max(axis=(1, 2)), np.abs(triangles).max(axis=(1, 2)))
    noise = 64 * np.finfo(float).eps * largest * reach**2

    def volume(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        value = np.einsum("ij,ij->i", np.cross(u, v), w)
        return np.where(np.abs(value) <= noise, 0.0, value)

    above = volume(b - a, c - a, -a)
    below = volume(b - a, c - a, q - a)
    sides = np.stack([volume(q, a, b), volume(q, b, c), volume(q, c, a)])
    split = (above * below <= 0) & ((above != 0) | (below != 0))
    return split & ((sides >= 0).all(axis=0) | (sides <= 0).all(axis=0))


def point_triangle_distances(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance of points [n, 3], or of one [3], from triangles [n, 3, 3] [m], shape [n]."""
    corners = np.moveaxis(triangles - points[..., None, :], 1, 0)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    best = np.full(len(triangles), np.inf)
    over = np.ones(len(triangles), dtype=bool)
    for k in range(3):
        a, edge = corners[k], corners[(k + 1) % 3] - corners[k]
        t = np.clip(-(a * edge).sum(1) / (edge * edge).sum(1), 0, 1)
        best = np.minimum(best, np.linalg.norm(a + t[:, None] * edge, axis=1))
        over &= (np.cross(edge, -a) * normal).sum(1) >= 0
    height = np.abs((corners[0] * normal).sum(1)) / np.linalg.norm(normal, axis=1)
    return np.where(over, np.minimum(best, height), best)
