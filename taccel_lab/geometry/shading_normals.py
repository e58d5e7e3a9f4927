# SPDX-License-Identifier: Apache-2.0
"""Normals of the curved surface that a triangle mesh stands for: facets smooth, edges sharp.

A file of triangles does not say which of its edges are the object's and which come from cutting a
curved surface into facets. A facet's edge is bent a little, and its facets are narrow: chords of
width w that turn by an angle a from one to the next lie up to ``w a / 8`` inside the surface, which
whoever exported the file kept small. Edges that are bent more, or whose facets would be coarser
chords than anybody exports, are the object's own and stay sharp.
"""

from __future__ import annotations

import math

import numpy as np

FACET_DEG = 30.0
"""Edges bent by more are the object's."""
FACET_SAG_M = 5e-5
"""So are those whose facets would lie further inside the curved surface [m]: exports at coarse
settings keep chords within some hundredths of a millimetre."""


def corner_normals(vertices_m: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Outward unit normals of the curved surface at the corners of each triangle.

    The mean over the facets around the corner that smooth edges join to the triangle, weighted by
    area, so that a flat face beside a narrow fillet stays flat, and by their angle there, so that
    it does not matter how a facet was cut into triangles.

    Args:
        vertices_m: Vertices [m], shape [n, 3].
        triangles: Outward triangles, shape [m, 3].

    Returns:
        Shape [m, 3, 3]: triangle, corner, xyz. Those of triangles without area are zero.
    """
    from scipy import sparse

    corners = vertices_m[triangles]
    twice, flat, area2 = _facets(corners)
    count = triangles.size
    fans, fan = _fans(triangles, corners, flat, area2)
    belongs = sparse.csr_array((np.ones(count), (np.arange(count), fan)), shape=(count, fans))
    pairs = sparse.coo_array(belongs @ belongs.T)
    mine, other = pairs.coords[0] // 3, pairs.coords[1] // 3
    # Around the tip of a cone all facets are joined, and the far ones say nothing of this one.
    near = np.einsum("ij,ij->i", flat[mine], flat[other]) >= math.cos(math.radians(FACET_DEG))
    weight = _corner_angles(corners).ravel()[pairs.coords[1][near]]
    total = np.zeros((count, 3))
    np.add.at(total, pairs.coords[0][near], weight[:, None] * twice[other[near]])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return (total / np.maximum(length, np.finfo(float).tiny)).reshape(-1, 3, 3)


def split_at_creases(
    vertices_m: np.ndarray, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Give each smooth part around a vertex its own vertex, so that renderers which average
    normals at vertices draw sharp edges sharp.

    Args:
        vertices_m: Vertices [m], shape [n, 3].
        triangles: Outward triangles, shape [m, 3].

    Returns:
        The vertex that each new vertex copies, int64 [k], and triangles of new vertices [m, 3].
    """
    corners = vertices_m[triangles]
    _, flat, area2 = _facets(corners)
    _, fan = _fans(triangles, corners, flat, area2)
    _, first, index = np.unique(fan, return_index=True, return_inverse=True)
    return triangles.ravel()[first].astype(np.int64), index.reshape(-1, 3)


def _facets(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Twice the vector area, the unit normal (0 without area) and twice the area of triangles."""
    twice = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area2 = np.linalg.norm(twice, axis=1)
    return twice, twice / np.maximum(area2, np.finfo(float).tiny)[:, None], area2


def _fans(
    triangles: np.ndarray, corners: np.ndarray, flat: np.ndarray, area2: np.ndarray
) -> tuple[int, np.ndarray]:
    """How many groups of corners smooth edges join, and the group of each corner, [3 m]."""
    from scipy import sparse

    joined, count = _joined_corners(triangles, corners, flat, area2), triangles.size
    graph = sparse.coo_array((np.ones(len(joined)), tuple(joined.T)), shape=(count, count))
    return sparse.csgraph.connected_components(graph, directed=False)


def _corner_angles(corners: np.ndarray) -> np.ndarray:
    """Angles of triangles [rad], corners [m, 3, 3] to [m, 3]."""
    one = np.roll(corners, -1, axis=1) - corners
    other = np.roll(corners, 1, axis=1) - corners
    across = np.linalg.norm(np.cross(one, other), axis=2)
    return np.arctan2(across, (one * other).sum(axis=2))


def _joined_corners(
    triangles: np.ndarray, corners: np.ndarray, flat: np.ndarray, area2: np.ndarray
) -> np.ndarray:
    """Corners, numbered 3 triangle + corner, that meet at a vertex across a smooth edge, [k, 2]."""
    # Each triangle's side k runs from corner k to the next; a side sought turns up reversed.
    start, end = triangles, np.roll(triangles, -1, axis=1)
    key = np.minimum(start, end).astype(np.int64) * (triangles.max() + 1) + np.maximum(start, end)
    order = np.argsort(key.ravel(), kind="stable")
    same = key.ravel()[order][1:] == key.ravel()[order][:-1]
    one, two = order[:-1][same], order[1:][same]
    f, g = one // 3, two // 3
    turn = np.arccos(np.clip(np.einsum("ij,ij->i", flat[f], flat[g]), -1.0, 1.0))
    side = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).ravel()[one]
    width = np.minimum(area2[f], area2[g]) / np.maximum(side, np.finfo(float).tiny)
    smooth = (turn <= math.radians(FACET_DEG)) & (width * turn / 8 <= FACET_SAG_M)
    one, two = one[smooth], two[smooth]
    one_end, two_end = _next_corner(one), _next_corner(two)
    # The same vertices on both sides, whichever way the second triangle turns.
    turned = triangles.ravel()[one] != triangles.ravel()[two]
    first, second = np.where(turned, two_end, two), np.where(turned, two, two_end)
    return np.concatenate([np.stack([one, first], 1), np.stack([one_end, second], 1)])


def _next_corner(corner: np.ndarray) -> np.ndarray:
    return 3 * (corner // 3) + (corner % 3 + 1) % 3
