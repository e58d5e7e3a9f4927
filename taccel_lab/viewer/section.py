# SPDX-License-Identifier: Apache-2.0
"""A tet mesh cut by a plane: the face of the cut with values on it, and what is left of the skin.

Tets are cut through, none is hidden or kept as a whole: the area of the cut is that of the section.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_OCTAHEDRON = ((4, 9, 7, 8), (4, 9, 8, 5), (4, 9, 6, 7), (4, 9, 5, 6))
"""The inner part of a ten-node tet, by its middles 4 (01) and 9 (23)."""
_CORNERS = ((0, 4, 6, 7), (1, 5, 4, 8), (2, 6, 5, 9), (3, 7, 9, 8))


@dataclass(frozen=True)
class SectionSurface:
    """Triangles with values at their points."""

    points: np.ndarray
    """[point, 3], in the unit of the nodes."""
    faces: np.ndarray
    """int64 [face, 3], outward."""
    values: np.ndarray
    """[point]."""

    def area(self) -> float:
        """Area of all triangles, in the square of the nodes' unit."""
        a, b, c = (self.points[self.faces[:, i]] for i in range(3))
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def linear_tets(tets: np.ndarray) -> np.ndarray:
    """Four-node tets of the same nodes, [n, 4]: a ten-node tet becomes eight."""
    if tets.shape[1] == 4:
        return np.asarray(tets, dtype=np.int64)
    parts = [tets[:, list(part)] for part in (*_CORNERS, *_OCTAHEDRON)]
    return np.concatenate(parts).astype(np.int64)


def cut_tets(
    nodes: np.ndarray, tets: np.ndarray, values: np.ndarray, point: np.ndarray, normal: np.ndarray
) -> SectionSurface:
    """The section of four-node tets with a plane.

    Args:
        nodes: [node, 3].
        tets: [tet, 4].
        values: At the nodes, [node]; linear in each tet.
        point: Of the plane, [3].
        normal: Of the plane, towards the side that is taken away, any length but 0, [3]; the faces
            of the section look that way.
    """
    distance = (nodes - point) @ (normal / np.linalg.norm(normal))
    above = distance >= 0
    crossed = tets[np.isin(above[tets].sum(axis=1), (1, 2, 3))]
    up = above[crossed]
    count = up.sum(axis=1)
    # A corner alone on its side: a triangle of its three edges.
    lone = np.concatenate([_lone(crossed[count == 1], up[count == 1]),
                           _lone(crossed[count == 3], ~up[count == 3])])  # fmt: skip
    triangles = np.stack([lone[:, [0, i]] for i in (1, 2, 3)], axis=1)
    # Two and two: the four edges between them, in turn round the section.
    pairs = crossed[count == 2]
    order = np.argsort(~up[count == 2], axis=1, kind="stable")
    a, b, c, d = np.take_along_axis(pairs, order, axis=1).T
    ring = np.stack([np.stack(e, axis=1) for e in ((a, c), (a, d), (b, d), (b, c))], axis=1)
    edges = np.concatenate([triangles, ring[:, [0, 1, 2]], ring[:, [0, 2, 3]]])
    surface = _on_edges(nodes, values, distance, edges)
    return _facing(surface, normal)


def clip_faces(
    nodes: np.ndarray, faces: np.ndarray, values: np.ndarray, point: np.ndarray, normal: np.ndarray
) -> SectionSurface:
    """Triangles as far as they lie behind a plane, those across it cut; arguments as ``cut_tets``,
    ``faces`` [face, 3]."""
    distance = (nodes - point) @ (normal / np.linalg.norm(normal))
    above = distance >= 0
    count = above[faces].sum(axis=1)
    kept = np.repeat(faces[count == 0][:, :, None], 2, axis=2)
    one = _first(faces[count == 2], ~above[faces[count == 2]])  # one corner is kept
    a, b, c = one.T
    corner = np.stack([np.stack(e, axis=1) for e in ((a, a), (a, b), (a, c))], axis=1)
    two = _first(faces[count == 1], above[faces[count == 1]])  # one corner is lost
    a, b, c = two.T
    ring = np.stack([np.stack(e, axis=1) for e in ((a, b), (b, b), (c, c), (c, a))], axis=1)
    edges = np.concatenate([kept, corner, ring[:, [0, 1, 2]], ring[:, [0, 2, 3]]])
    return _on_edges(nodes, values, distance, edges)


def _lone(tets: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Corners with the chosen one first, [n, 4]."""
    order = np.argsort(~chosen, axis=1, kind="stable")
    return np.take_along_axis(tets, order, axis=1)


def _first(faces: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Corners turned until the chosen one comes first, [n, 3]."""
    start = np.argmax(chosen, axis=1) if len(faces) else np.zeros(0, dtype=np.int64)
    turn = (start[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, turn, axis=1).reshape(-1, 3)


def _on_edges(
    nodes: np.ndarray, values: np.ndarray, distance: np.ndarray, edges: np.ndarray
) -> SectionSurface:
    """Triangles whose corners are where edges cross the plane, [face, 3, 2]; an edge from a node to
    itself is that node."""
    ends = np.sort(edges.reshape(-1, 2), axis=1).astype(np.int64)
    # One number an edge: to sort pairs takes ten times as long.
    unique, index = np.unique(ends[:, 0] * len(nodes) + ends[:, 1], return_inverse=True)
    first, second = np.divmod(unique, len(nodes))
    span = distance[first] - distance[second]
    share = np.divide(distance[first], span, out=np.zeros(len(unique)), where=first != second)
    points = nodes[first] + share[:, None] * (nodes[second] - nodes[first])
    found = values[first] + share * (values[second] - values[first])
    return SectionSurface(points, index.reshape(-1, 3), found)


def _facing(surface: SectionSurface, normal: np.ndarray) -> SectionSurface:
    a, b, c = (surface.points[surface.faces[:, i]] for i in range(3))
    back = np.cross(b - a, c - a) @ normal < 0
    faces = surface.faces.copy()
    faces[back] = faces[back][:, ::-1]
    return SectionSurface(surface.points, faces, surface.values)
