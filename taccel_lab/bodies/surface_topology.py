# SPDX-License-Identifier: Apache-2.0
"""Adjacency of the collision surface, what the contact weights need to count features once, and its
separate parts: whether they are closed, and which side is outside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.bodies.mass_properties import winding_number
from taccel_lab.errors import InputError
from taccel_lab.geometry.connectivity import compacted, piece_of_cells, piece_of_nodes

NO_BALL_INSET = 0.05
"""Inset over the radius of a ball at which faces are too coarse for it to have one: between nodes
that far apart it is the faces that say where it is."""


@dataclass(frozen=True)
class SurfaceTopology:
    """Faces, edges and vertices of all collision surfaces, with their incidence.

    Indices of nodes are global (soft nodes first, then kinematic vertices).
    """

    faces: np.ndarray
    """Node indices, outward, int32, shape [face_count, 3]."""
    edges: np.ndarray
    """Node indices, int32, shape [edge_count, 2]."""
    face_edges: np.ndarray
    """Edge opposite order (01, 12, 20) of each face, int32, shape [face_count, 3]."""
    edge_faces: np.ndarray
    """The one or two faces of each edge, -1 for none, int32, shape [edge_count, 2]."""
    node_face_starts: np.ndarray
    """CSR into ``node_faces``, int32, shape [node_count + 1]."""
    node_faces: np.ndarray
    """Incident faces, ascending, int32."""
    node_edge_starts: np.ndarray
    """CSR into ``node_edges``, int32, shape [node_count + 1]."""
    node_edges: np.ndarray
    """Incident edges, ascending, int32."""


def _incidence(items: np.ndarray, node_count: int) -> tuple[np.ndarray, np.ndarray]:
    """CSR from node to the rows of ``items`` that hold it."""
    nodes = items.ravel()
    rows = np.repeat(np.arange(len(items)), items.shape[1])
    order = np.lexsort((rows, nodes))
    starts = np.searchsorted(nodes[order], np.arange(node_count + 1))
    return starts.astype(np.int32), rows[order].astype(np.int32)


def surface_topology(faces: np.ndarray, node_count: int, what: str) -> SurfaceTopology:
    """Build the incidence of a triangle surface; an edge of three or more faces is rejected."""
    corners = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges, inverse = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True)
    counts = np.bincount(inverse.ravel(), minlength=len(edges))
    if counts.max() > 2:
        raise InputError(
            f"{what}: {int((counts > 2).sum())} edges belong to more than two faces; "
            "a collision surface must be manifold"
        )
    face_edges = inverse.reshape(-1, 3)
    edge_faces = np.full((len(edges), 2), -1, dtype=np.int32)
    order = np.argsort(face_edges.ravel(), kind="stable")
    sorted_edges = face_edges.ravel()[order]
    first = np.ones(len(order), dtype=bool)
    first[1:] = sorted_edges[1:] != sorted_edges[:-1]
    edge_faces[sorted_edges[first], 0] = order[first] // 3
    edge_faces[sorted_edges[~first], 1] = order[~first] // 3
    node_face_starts, node_faces = _incidence(faces, node_count)
    node_edge_starts, node_edges = _incidence(edges, node_count)
    return SurfaceTopology(
        faces=faces.astype(np.int32),
        edges=edges.astype(np.int32),
        face_edges=face_edges.astype(np.int32),
        edge_faces=edge_faces,
        node_face_starts=node_face_starts,
        node_faces=node_faces,
        node_edge_starts=node_edge_starts,
        node_edges=node_edges,
    )


def surface_areas(
    positions: np.ndarray,
    topology: SurfaceTopology,
    shares: np.ndarray | None = None,
    preferred: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rest areas [m^2] of nodes, edges (a third of each incident face) and faces.

    The area of a node is what it shows in one direction n: the sum over its faces of (share of the
    area) max(0, n_face . n), averaged over the normals n of its faces. Within a flat face this is
    its share of each face; at a right-angled rim, the mean of both sides and not their sum.

    ``positions``: [env, node, 3]. ``shares``: part of a face's area that each of its corners stands
    for, [face, 3]; a third when None. ``preferred``: faces whose normals alone count where a node
    has such a face, bool, [face]; the contact face of a gel pad. Returns [env, node], [env, edge]
    and [env, face].
    """
    p = positions[:, topology.faces]
    cross = np.cross(p[:, :, 1] - p[:, :, 0], p[:, :, 2] - p[:, :, 0])
    size = np.linalg.norm(cross, axis=-1)
    edge_area = np.zeros((len(positions), len(topology.edges)))
    for corner in range(3):
        for env in range(len(positions)):
            edge_area[env] += np.bincount(
                topology.face_edges[:, corner], size[env] / 6.0, minlength=len(topology.edges)
            )
    shares = np.full(topology.faces.shape, 1 / 3) if shares is None else shares
    node_area = _shown_areas(cross, size, topology, shares, preferred)
    return node_area, edge_area, 0.5 * size


def face_reaches_sq(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Square of the radius of the smallest circle around each face [m^2], [env, face].

    ``positions``: [env, node, 3]. Half of the longest side where the angle opposite is not acute,
    else the circle through the corners, of radius a b c / (4 area).
    """
    p = positions[:, faces]
    sides_sq = np.sort(((p - np.roll(p, 1, axis=2)) ** 2).sum(axis=-1), axis=-1)
    cross = np.cross(p[:, :, 1] - p[:, :, 0], p[:, :, 2] - p[:, :, 0])
    acute = sides_sq[..., 2] < sides_sq[..., :2].sum(axis=-1)
    around = sides_sq.prod(axis=-1) / np.where(acute, 4 * (cross**2).sum(axis=-1), 1.0)
    return np.where(acute, around, sides_sq[..., 2] / 4)


def ball_insets(radius_m: np.ndarray | float, reaches_sq: np.ndarray) -> np.ndarray:
    """How far faces may reach into a ball [m]; ``reaches_sq``: ``face_reaches_sq`` of those of
    quadratic elements, 0 for faces that are flat.

    Under a ball the face of a quadratic element is curved, and the flat faces between its nodes
    are chords of it: where the nodes touch the ball, the chords are inside by the sagitta
    r^2 / (2 R). Without an inset the chords kept the nodes off, and at a short range they carried
    97 % of a contact, at one point each, where nodes measure it. Twice the sagitta, so that the gel
    may stretch by two fifths first; less where faces are large for the ball.
    """
    inset = reaches_sq / radius_m
    return inset * np.maximum(1 - inset / (NO_BALL_INSET * radius_m), 0.0)


def _shown_areas(
    cross: np.ndarray,
    size: np.ndarray,
    topology: SurfaceTopology,
    shares: np.ndarray,
    preferred: np.ndarray | None,
) -> np.ndarray:
    """Node areas from the cross products of the faces' edges [env, face, 3] and their sizes."""
    starts, around = topology.node_face_starts, topology.node_faces
    counts = np.diff(starts)
    owner = np.repeat(np.arange(len(counts)), counts)
    share = shares[around][topology.faces[around] == owner[:, None]]
    # A direction is one face at one node; each is paired with all faces at that node.
    direction = np.repeat(np.arange(len(around)), counts[owner])
    within = np.arange(len(direction)) - np.repeat(
        np.cumsum(counts[owner]) - counts[owner], counts[owner]
    )
    other = starts[owner[direction]] + within
    counted = np.ones(len(around), dtype=bool)
    if preferred is not None:
        has_preferred = np.bincount(owner, preferred[around], minlength=len(counts)) > 0
        counted = preferred[around] | ~has_preferred[owner]
    areas = np.zeros((len(cross), len(counts)))
    for env in range(len(cross)):
        normals = cross[env] / np.maximum(size[env], np.finfo(float).tiny)[:, None]
        facing = (normals[around[direction]] * normals[around[other]]).sum(axis=1)
        weight = np.maximum(facing, 0.0) * 0.5 * size[env, around[other]] * share[other]
        shown = np.bincount(direction, weight, minlength=len(around))
        areas[env] = np.bincount(owner[counted], shown[counted], minlength=len(counts))
    return areas / np.maximum(np.bincount(owner[counted], minlength=len(counts)), 1)


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
