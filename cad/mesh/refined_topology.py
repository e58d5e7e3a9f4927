# SPDX-License-Identifier: Apache-2.0
"""Connectivity of a structured mesh whose plan is twice as fine towards the contact face.

The coarse plan is every second node of the fine one, both cut along the same diagonals, so that
each coarse triangle holds four fine ones. Coarse prisms lead up from the bottom, then one layer of
prisms whose floor is a coarse and whose ceiling four fine triangles, then fine prisms up to the
top. The walls of the prisms between are cut from the middle of their upper edge, whichever
neighbour looks at them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from taccel_lab.cad.mesh.structured_topology import plan_quads, plan_triangles, prism_tets
from taccel_lab.geometry.tet_mesh import boundary_faces


@dataclass(frozen=True)
class RefinedTopology:
    """Connectivity of one O-grid, coarse below and fine above."""

    coarse_nodes: np.ndarray
    """Fine plan node at each coarse plan node, shape [coarse plan count]."""
    fine_count: int
    """Nodes of the fine plan."""
    tets: np.ndarray
    """int32; nodes are the coarse levels from the bottom, then the fine levels."""
    faces: np.ndarray
    """Boundary triangles, int32, shape [face_count, 3]."""


def level_of_node(coarse_count: int, fine_count: int, coarse: int, fine: int) -> np.ndarray:
    """Level of each node, the coarse ones 0 to ``coarse``, the fine ones above, shape [nodes]."""
    return np.concatenate([
        np.repeat(np.arange(coarse + 1), coarse_count),
        np.repeat(coarse + 1 + np.arange(fine + 1), fine_count),
    ])  # fmt: skip


def coarse_plan_nodes(core: int, rings: int) -> np.ndarray:
    """Node of the fine plan (2 core, 2 rings) at each node of the plan (core, rings)."""
    even = 2 * np.arange(core + 1)
    inner = (even[:, None] * (2 * core + 1) + even[None, :]).ravel()
    ring = np.arange(2, 2 * rings + 1, 2)[:, None]
    start = (2 * core + 1) ** 2
    loops = start + (ring - 1) * 8 * core + 2 * np.arange(4 * core)[None, :]
    return np.concatenate([inner, loops.ravel()])


@lru_cache(maxsize=16)
def refined_topology(core: int, rings: int, coarse: int, fine: int) -> RefinedTopology:
    """Topology over the coarse plan (core, rings): ``coarse`` layers, one between, ``fine`` layers.

    Levels 0 to ``coarse`` hold the coarse plan, the levels above, ``fine`` + 1 of them, the plan of
    twice its counts.
    """
    nodes = coarse_plan_nodes(core, rings)
    count = len(nodes)
    fine_count = (2 * core + 1) ** 2 + 16 * core * rings
    start = (coarse + 1) * count
    triangles = plan_triangles(core, rings)
    parts = [prism_tets(triangles, k * count, (k + 1) * count) for k in range(coarse)]
    floor = triangles + coarse * count
    middle = _edge_middles(core, rings)
    mids = np.stack([middle(triangles[:, k], triangles[:, (k + 1) % 3]) for k in range(3)], axis=1)
    parts.append(_between(floor, nodes[triangles] + start, mids + start))
    fine_triangles = plan_triangles(2 * core, 2 * rings)
    for k in range(fine):
        low = start + k * fine_count
        parts.append(prism_tets(fine_triangles, low, low + fine_count))
    tets = np.concatenate(parts).astype(np.int32)
    faces = boundary_faces(tets)
    for array in (nodes, tets, faces):
        array.setflags(write=False)
    return RefinedTopology(nodes, fine_count, tets, faces)


class _edge_middles:
    """Fine plan node in the middle of coarse plan edges."""

    def __init__(self, core: int, rings: int) -> None:
        nodes, quads = coarse_plan_nodes(core, rings), plan_quads(core, rings)
        fine = plan_quads(2 * core, 2 * rings)
        self._count = len(nodes)
        # A coarse quad's edge and diagonal middles are nodes that both ends' fine quads share.
        neighbours: dict[int, set[int]] = {}
        for quad in fine.tolist():
            for k, node in enumerate(quad):
                found = neighbours.setdefault(node, set())
                found.update((quad[(k + 1) % 4], quad[(k + 3) % 4]))
        self._middle: dict[int, int] = {}
        for quad in quads.tolist():
            ends = [int(nodes[c]) for c in quad]
            edge = []
            for k in range(4):
                shared = neighbours[ends[k]] & neighbours[ends[(k + 1) % 4]]
                (found,) = shared
                edge.append(found)
                self._store(quad[k], quad[(k + 1) % 4], found)
            (center,) = set.intersection(*(neighbours[e] for e in edge)) - set(ends)
            self._store(quad[0], quad[2], center)

    def _store(self, a: int, b: int, middle: int) -> None:
        self._middle[min(a, b) * self._count + max(a, b)] = middle

    def __call__(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        keys = np.minimum(a, b) * self._count + np.maximum(a, b)
        return np.array([self._middle[int(key)] for key in keys])


def _between(floor: np.ndarray, corners: np.ndarray, mids: np.ndarray) -> np.ndarray:
    """Seven tets over each coarse triangle; ``mids[:, k]`` lies between corners k and k + 1."""
    p, q, r = floor.T
    top_p, top_q, top_r = corners.T
    pq, qr, rp = mids.T
    tets = [
        # At each upper corner, over the floor's corner.
        (p, top_p, pq, rp),
        (q, top_q, qr, pq),
        (r, top_r, rp, qr),
        # The octahedron in the middle, cut along the diagonal from p to the middle of q r.
        (p, q, qr, pq),
        (p, q, r, qr),
        (p, r, rp, qr),
        (p, pq, qr, rp),
    ]
    return np.concatenate([np.stack(tet, axis=1) for tet in tets])
