# SPDX-License-Identifier: Apache-2.0
"""Meshes that no simulation can use, refused with the ids of what is wrong and what is allowed."""

from __future__ import annotations

import numpy as np

from taccel_lab.bodies.crossings import self_crossings
from taccel_lab.errors import InputError
from taccel_lab.files.triangle_file import FLAT as FLAT_TRIANGLE
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.connectivity import pieces_of_pairs
from taccel_lab.geometry.length_units import other_readings
from taccel_lab.geometry.tet_checks import check_connectivity, first_of, refuse_any, unique_rows

COINCIDENT = 1e-9
"""Distance over extent at which vertices count as the same."""
FLAT = FLAT_TRIANGLE
"""Volume over longest edge cubed of a tet; of a triangle see there."""


def check_extent(vertices: np.ndarray, what: str, limits_m: tuple[float, float]) -> None:
    """Refuse sizes that come from another unit of length."""
    extent = float((vertices.max(axis=0) - vertices.min(axis=0)).max())
    low, high = limits_m
    if not low <= extent <= high:
        allowed = f"at most {high:g}" if extent > high else f"at least {low:g}"
        raise InputError(
            f"{what} is {extent:g} m across; {allowed} m is allowed. Lengths are in metres; "
            f"{other_readings(extent, 'metres')}: a mesh in millimetres must be scaled by 1e-3"
        )


def check_surface(vertices: np.ndarray, faces: np.ndarray, what: str, *, closed: bool) -> None:
    """Refuse a triangle surface that is not manifold, oriented, clean and free of crossings.

    ``vertices``: [n, 3] [m]; ``faces``: [m, 3]; ``closed``: whether open edges are rejected too.
    """
    faces = faces.astype(np.int64)
    unused = np.setdiff1d(np.arange(len(vertices)), faces)
    refuse_any(unused, what, "vertices belong to no face", "vertices", "; remove them")
    _check_duplicates(vertices, what)
    _check_shape(vertices, faces, what, closed)


def _check_shape(vertices: np.ndarray, faces: np.ndarray, what: str, closed: bool) -> None:
    check_edges(vertices, faces, what, closed=closed)
    _check_faces(vertices, faces, what)
    _check_fans(faces, what)
    _check_folds(vertices, faces, what)
    edges, crossed = self_crossings(vertices, faces)
    if len(edges):
        raise InputError(
            f"{what} intersects itself: {len(edges)} times an edge passes through a face, "
            f"edges (vertex, vertex) {first_of(edges)} through faces {first_of(crossed)}; "
            "a surface must not cross or touch itself"
        )


def check_tets(mesh: TetMesh, what: str) -> None:
    """Refuse tets that are flat, overlap or share no face, and nodes that belong to none."""
    nodes, tets = mesh.nodes_m, mesh.tets.astype(np.int64)
    corners = nodes[tets]
    sides = np.linalg.norm(corners[:, [0, 0, 0, 1, 1, 2]] - corners[:, [1, 2, 3, 2, 3, 3]], axis=2)
    flat = np.flatnonzero(6 * mesh.volumes_m3() <= FLAT * sides.max(axis=1) ** 3)
    hint = f"; 6 V must exceed {FLAT:g} times the longest edge cubed"
    refuse_any(flat, what, "tets have no volume to speak of", "tets", hint)
    check_connectivity(mesh, what)
    _check_duplicates(nodes, what)
    _check_shape(nodes, mesh.faces.astype(np.int64), f"the surface of {what}", closed=True)


def _check_faces(vertices: np.ndarray, faces: np.ndarray, what: str) -> None:
    p = vertices[faces]
    longest = np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).max(axis=1)
    doubled = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    flat = np.flatnonzero(doubled <= FLAT * longest**2)
    hint = f"; twice the area must exceed {FLAT:g} times the longest edge squared"
    refuse_any(flat, what, "faces have no area to speak of", "faces", hint)


def _check_duplicates(points: np.ndarray, what: str) -> None:
    extent = float((points.max(axis=0) - points.min(axis=0)).max())
    near = COINCIDENT * extent
    # Loads warp, which what draws or plans does without.
    from taccel_lab.bodies.box_pairs import box_pairs

    pairs = np.stack(box_pairs((points - near, points + near), (points, points)), axis=1)
    pairs = pairs[pairs[:, 0] < pairs[:, 1]]
    pairs = pairs[np.linalg.norm(np.subtract(*points[pairs.T]), axis=1) <= near]
    said = "pairs of vertices lie at the same place"
    refuse_any(pairs, what, said, "pairs", "; merge them")


def check_edges(vertices: np.ndarray, faces: np.ndarray, what: str, *, closed: bool) -> None:
    """Refuse edges of more than two faces, of two that run the same way, and open ones if
    ``closed``; also faces that name a vertex twice."""
    faces = faces.astype(np.int64)
    repeated = np.flatnonzero((faces == np.roll(faces, 1, axis=1)).any(axis=1))
    hint = "; a face needs three vertices"
    refuse_any(repeated, what, "faces name a vertex twice", "faces", hint)
    directed = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges, inverse, uses = unique_rows(np.sort(directed, axis=1))
    crowded, named = edges[uses > 2], "edges (vertex, vertex)"
    refuse_any(crowded, f"{what} is not manifold", "edges belong to more than two faces", named)
    open_edges = edges[uses == 1]
    if closed and len(open_edges):
        hint = "; close it there"
        if len(np.unique(vertices, axis=0)) < len(vertices):
            hint = "; some vertices coincide: merge them if the surface was meant to be closed"
        said = "edges belong to one face only"
        refuse_any(open_edges, f"{what} is not closed", said, named, hint)
    ahead = np.bincount(inverse, directed[:, 0] < directed[:, 1], minlength=len(edges))
    turned = edges[(uses == 2) & (ahead != 1)]
    if len(turned):
        raise InputError(
            f"{what}: neighbouring faces are oriented differently at {len(turned)} edges: "
            f"{named} {first_of(turned)}; all faces must be outward by the right-hand rule"
        )


def _inner_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges of two faces [n, 2], and their two places among the edges 01, 12, 20 of all faces
    [n, 2]; no edge may have more."""
    edges, inverse, uses = unique_rows(
        np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    )
    order = np.argsort(inverse, kind="stable")
    places = order[uses[inverse[order]] == 2].reshape(-1, 2)
    return edges[inverse[places[:, 0]]], places


def _check_fans(faces: np.ndarray, what: str) -> None:
    """Faces around a vertex form one fan: two that meet in a point only are not a surface."""
    edges, places = _inner_edges(faces)
    # Corners of two faces at the same end of a shared edge belong to the same fan.
    links = []
    for end in range(2):
        at = [(faces[places[:, k] // 3] == edges[:, end, None]).argmax(axis=1) for k in range(2)]
        links.append(np.stack([3 * (places[:, k] // 3) + at[k] for k in range(2)], axis=1))
    labels = pieces_of_pairs(np.concatenate(links), faces.size)
    fan_nodes = faces.ravel()[np.unique(labels, return_index=True)[1]]
    nodes, fans = np.unique(fan_nodes, return_counts=True)
    pinched = nodes[fans > 1]
    said = "vertices join parts that share no edge"
    refuse_any(pinched, f"{what} is not manifold", said, "vertices")


def _check_folds(vertices: np.ndarray, faces: np.ndarray, what: str) -> None:
    """Two faces of an edge that lie on each other."""
    opposite = faces[:, [2, 0, 1]].ravel()
    edge, inner = _inner_edges(faces)
    origin, along = vertices[edge[:, 0]], vertices[edge[:, 1]] - vertices[edge[:, 0]]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    arms = []
    for k in range(2):
        arm = vertices[opposite[inner[:, k]]] - origin
        arm -= (arm * along).sum(axis=1, keepdims=True) * along
        arms.append(arm / np.linalg.norm(arm, axis=1, keepdims=True))
    # From the chord: the scalar product of nearly equal directions has only eight digits.
    folded = np.flatnonzero(np.linalg.norm(arms[0] - arms[1], axis=1) < 1e-9)
    pairs = np.sort(inner[folded] // 3, axis=1)
    refuse_any(pairs, what, "pairs of faces lie on each other", "faces")
