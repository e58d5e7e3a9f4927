# SPDX-License-Identifier: Apache-2.0
"""Do any surfaces intersect? A referee in numpy that shares no code with the solver.

Two closed surfaces intersect exactly when an edge of one crosses a face of the other, or when one
lies inside the other as a whole. Crossings are found from the signs of tet volumes, containment
from the winding number [Van Oosterom and Strackee 1983, The Solid Angle of a Plane Triangle]. The
gel counts with its whole boundary, glued faces included; bodies are not checked against each
other. Surfaces that only touch in a plane they share are not told apart from surfaces that do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.model import Model
from taccel_lab.scene.primitives import Ball, unique_edges
from taccel_lab.state import State


class IntersectionKind(StrEnum):
    """How two things overlap."""

    CROSSING = "crossing"
    """An edge of one surface passes through a face of the other, or the ball reaches a gel face."""
    BODY_INSIDE_GEL = "body inside gel"
    GEL_INSIDE_BODY = "gel inside body"
    INVERTED_TET = "inverted tet"


@dataclass(frozen=True)
class Intersection:
    """One kind of overlap of one body with the gel in one environment."""

    kind: IntersectionKind
    body: str
    """Name of the kinematic body; empty for inverted tets."""
    count: int
    """Crossing pairs, components inside, or tets."""
    point_m: np.ndarray
    """One place where it happens [m], shape [3]."""


def find_intersections(model: Model, state: State) -> list[list[Intersection]]:
    """All overlaps of gel and kinematic bodies, one list per environment; empty when separate."""
    positions = state.positions.numpy()
    poses = state.poses.numpy().reshape(model.env_count, len(model.kinematic), 7)
    return [_intersections(model, positions[e], poses[e]) for e in range(model.env_count)]


def require_separated(model: Model, state: State) -> None:
    """Raise InputError when a body starts in the gel or a tet is inverted."""
    for env, found in enumerate(find_intersections(model, state)):
        for item in found:
            x, y, z = item.point_m * 1e3
            where = f"near x {x:.3f}, y {y:.3f}, z {z:.3f} mm"
            if item.kind == IntersectionKind.INVERTED_TET:
                raise InputError(
                    f"{item.count} tets of the gel are inverted in environment {env}, {where}"
                )
            raise InputError(
                f"{item.body!r} starts inside the gel in environment {env} ({item.kind}, {where}); "
                "allowed: a start pose with a gap everywhere between body and gel"
            )


def _intersections(model: Model, positions: np.ndarray, poses: np.ndarray) -> list[Intersection]:
    """Overlaps of one environment; positions [node_count, 3], poses [body_count, 7]."""
    mesh = model.scene.soft_bodies[0].mesh
    gel = positions[: model.soft_count]
    found = _inverted_tets(gel, mesh.tets)
    for arrays, body, pose in zip(
        model.kinematic, model.scene.kinematic_bodies, poses, strict=True
    ):
        if isinstance(body.shape, Ball):
            items = _ball_overlaps(gel, mesh.faces, pose[:3], body.shape.radius_m)
        else:
            vertices = _rotate(pose[3:], body.shape.vertices_m) + pose[:3]
            items = _surface_overlaps(gel, mesh.faces, vertices, body.shape.faces)
        found += [Intersection(kind, arrays.name, count, point) for kind, count, point in items]
    return found


_Overlaps = list[tuple[IntersectionKind, int, np.ndarray]]


def _rotate(quaternion: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Rotate points [n, 3] by a unit quaternion (x, y, z, w)."""
    axis, w = quaternion[:3], quaternion[3]
    across = 2 * np.cross(axis, points)
    return points + w * across + np.cross(axis, across)


def _inverted_tets(nodes: np.ndarray, tets: np.ndarray) -> list[Intersection]:
    p = nodes[tets]
    bad = np.flatnonzero(~(np.linalg.det(p[:, 1:] - p[:, :1]) > 0))
    if len(bad) == 0:
        return []
    return [Intersection(IntersectionKind.INVERTED_TET, "", len(bad), p[bad[0]].mean(axis=0))]


def _ball_overlaps(
    nodes: np.ndarray, faces: np.ndarray, centre: np.ndarray, radius: float
) -> _Overlaps:
    distance = point_face_distances(centre, nodes[faces])
    near = distance <= radius
    if near.any():
        face = int(np.argmin(distance))
        return [(IntersectionKind.CROSSING, int(near.sum()), nodes[faces[face]].mean(axis=0))]
    if _is_inside(centre, nodes[faces]):
        return [(IntersectionKind.BODY_INSIDE_GEL, 1, centre)]
    return []


def _surface_overlaps(
    nodes: np.ndarray, faces: np.ndarray, vertices: np.ndarray, body_faces: np.ndarray
) -> _Overlaps:
    """Crossings, or else containment: without a crossing a component is inside as a whole."""
    through_body = _crossings(nodes[unique_edges(faces)], vertices[body_faces])
    through_gel = _crossings(vertices[unique_edges(body_faces)], nodes[faces])
    points = np.concatenate([through_body, through_gel])
    if len(points):
        return [(IntersectionKind.CROSSING, len(points), points[0])]
    inside = [v for v in vertices[_component_nodes(body_faces)] if _is_inside(v, nodes[faces])]
    found: _Overlaps = []
    if inside:
        found.append((IntersectionKind.BODY_INSIDE_GEL, len(inside), inside[0]))
    if _is_closed(body_faces):
        around = vertices[body_faces]
        inside = [p for p in nodes[_component_nodes(faces)] if _is_inside(p, around)]
        if inside:
            found.append((IntersectionKind.GEL_INSIDE_BODY, len(inside), inside[0]))
    return found


def _component_nodes(faces: np.ndarray) -> np.ndarray:
    """One node of each connected component of a surface."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    used, compact = np.unique(faces, return_inverse=True)
    compact = compact.reshape(faces.shape)
    rows, columns = compact[:, [0, 1]].ravel(), compact[:, [1, 2]].ravel()
    links = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(used), len(used)))
    _, labels = connected_components(links, directed=False)
    return used[np.unique(labels, return_index=True)[1]]


def _is_closed(faces: np.ndarray) -> bool:
    """Whether each edge belongs to two faces."""
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return bool((np.unique(pairs, axis=0, return_counts=True)[1] == 2).all())


def _is_inside(point: np.ndarray, triangles: np.ndarray) -> bool:
    """Winding number of a closed surface, triangles [n, 3, 3], of either orientation."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return bool(abs(angle.sum()) > 2 * np.pi)


def _crossings(edges: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Midpoints of the edges [n, 2, 3] that pass through triangles [m, 3, 3], one per pair."""
    edge, face = _overlapping_boxes(edges, triangles)
    p, q = edges[edge, 0], edges[edge, 1]
    a, b, c = (triangles[face, k] for k in range(3))
    above, below = _volume(a, b, c, p), _volume(a, b, c, q)
    sides = np.stack([_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)])
    hit = (above * below <= 0) & ((above != 0) | (below != 0))
    hit &= (sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)
    return 0.5 * (p + q)[hit]


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
