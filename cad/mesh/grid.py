# SPDX-License-Identifier: Apache-2.0
"""Connectivity of every structured mesh: an O-grid plan, layers of prisms, three tets a prism.

A square core of n x n cells is surrounded by rings of 4n cells. Every cell of the plan is cut along
the same diagonal, so that inner surface nodes have six triangles each. Each prism over a triangle
is cut into three tets by the order of its plan nodes, so neighbours always agree. Five tets per
hexahedron, with diagonals that alternate, have fewer and rounder tets, but their surface nodes have
four and eight triangles in turn, and in a nearly incompressible gel of linear tets that pattern
shows: on a press of a 2 mm ball the contact pressure alternated between 50 and 250 kPa from node to
node where this split gives a smooth field.

A body that is much smaller inside than at its surface has the plan halved on the way in: the lower
layers have every second node of the plan, and one layer of prisms leads over, whose floor is one
triangle and whose ceiling four. Its walls are cut from the middle of their upper edge, whichever
neighbour looks at them.

Nothing here depends on positions: the arrays are the same for every shape and focus.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from taccel_lab.geometry.tet_mesh import boundary_faces


@dataclass(frozen=True)
class Grid:
    """Connectivity of one block: its nodes stand level by level, level 0 at the back."""

    core: int
    rings: int
    layers: int
    level: np.ndarray
    """Level of each node, 0 to ``layers``, shape [nodes]."""
    plan: np.ndarray
    """Node of the plan that each node stands on, shape [nodes]."""
    tets: np.ndarray
    """int32, shape [tets, 4]."""
    faces: np.ndarray
    """Boundary triangles, int32, shape [faces, 3]."""

    @property
    def ring(self) -> np.ndarray:
        """Ring of each node, 0 in the core, shape [nodes]."""
        return ring_of_node(self.core, self.rings)[self.plan]


def core_perimeter(core: int) -> np.ndarray:
    """Nodes on the edge of the core, counter-clockwise from the corner (-, -)."""
    n = np.arange(core)
    i = np.concatenate([n, np.full(core, core), core - n, np.zeros(core, dtype=int)])
    j = np.concatenate([np.zeros(core, dtype=int), n, np.full(core, core), core - n])
    return i * (core + 1) + j


def plan_node_count(core: int, rings: int) -> int:
    """Nodes of a plan."""
    return (core + 1) ** 2 + 4 * core * rings


def plan_quads(core: int, rings: int) -> np.ndarray:
    """Cells of the plan, counter-clockwise, shape [core^2 + 4 core rings, 4]."""
    i, j = np.meshgrid(np.arange(core), np.arange(core), indexing="ij")
    a = (i * (core + 1) + j).ravel()
    inner_cells = np.stack([a, a + core + 1, a + core + 2, a + 1], axis=-1)
    loops = [core_perimeter(core)]
    loops += [(core + 1) ** 2 + 4 * core * r + np.arange(4 * core) for r in range(rings)]
    ring_cells = [
        np.stack([p, q, np.roll(q, -1), np.roll(p, -1)], axis=-1) for p, q in pairwise(loops)
    ]
    return np.concatenate([inner_cells, *ring_cells])


def plan_triangles(core: int, rings: int, mirrored: bool = False) -> np.ndarray:
    """Triangles of the plan, counter-clockwise, shape [2 cells, 3].

    With ``mirrored`` the cells of the rings are cut along the other diagonal in the second half of
    each side, so that on both sides of an outline's corner, where spokes lean towards it, the
    diagonal is the shorter one.
    """
    quads = plan_quads(core, rings)
    if mirrored:
        index = np.arange(len(quads)) - core**2
        turned = (index >= 0) & (index % core >= core / 2)
        quads = np.where(turned[:, None], np.roll(quads, -1, axis=1), quads)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def ring_of_node(core: int, rings: int) -> np.ndarray:
    """Ring of each plan node, 0 for the core, shape [plan nodes]."""
    return np.repeat(np.arange(rings + 1), [(core + 1) ** 2] + [4 * core] * rings)


@lru_cache(maxsize=16)
def grid_of(
    core: int, rings: int, layers: int, *, mirrored: bool = False, halved_layers: int = 0
) -> Grid:
    """Grid of a plan with ``core`` x ``core`` cells and ``rings`` rings.

    ``halved_layers`` of all ``layers``, the lowest, have the halved plan, for which core and rings
    are even; the layer above them leads over. ``mirrored`` is that of ``plan_triangles``.
    """
    triangles = plan_triangles(core, rings, mirrored)
    plans = [np.arange(plan_node_count(core, rings))] * (layers + 1)
    if halved_layers:
        plans[: halved_layers + 1] = [_halved_plan(core, rings)] * (halved_layers + 1)
    first = np.cumsum([0, *map(len, plans)])
    tets = []
    for k in range(layers):
        if k < halved_layers:
            halved = plan_triangles(core // 2, rings // 2)
            tets.append(_prism_tets(halved, first[k], first[k + 1]))
        elif k == halved_layers and halved_layers:
            tets.append(_halving_tets(core, rings, first[k], first[k + 1]))
        else:
            tets.append(_prism_tets(triangles, first[k], first[k + 1]))
    all_tets = np.concatenate(tets).astype(np.int32)
    arrays = (
        np.repeat(np.arange(layers + 1), [len(plan) for plan in plans]),
        np.concatenate(plans),
        all_tets,
        boundary_faces(all_tets),
    )
    for array in arrays:
        array.setflags(write=False)
    return Grid(core, rings, layers, *arrays)


def _prism_tets(triangles: np.ndarray, low: int, high: int) -> np.ndarray:
    """Three tets of each prism between the plan ``triangles`` of two levels, shape [3 n, 4].

    Nodes of the levels are the plan's plus ``low`` and ``high``.
    """
    # Ascending plan nodes p < q < r: the side over p q is cut from p below to q above, whichever
    # prism looks at it. Sorting may turn a triangle over, which the tets must undo.
    order = np.argsort(triangles, axis=1)
    p, q, r = np.take_along_axis(triangles, order, axis=1).T
    turned = (order[:, 1] - order[:, 0]) % 3 == 2
    tets = []
    for corners in (
        (p + low, q + low, r + low, r + high),
        (p + low, q + high, q + low, r + high),
        (p + low, p + high, q + high, r + high),
    ):
        tet = np.stack(corners, axis=1)
        tets.append(np.where(turned[:, None], tet[:, [0, 2, 1, 3]], tet))
    return np.concatenate(tets)


def _halved_plan(core: int, rings: int) -> np.ndarray:
    """Nodes of the plan at each node of the halved one."""
    even = np.arange(0, core + 1, 2)
    inner = (even[:, None] * (core + 1) + even[None, :]).ravel()
    ring = np.arange(2, rings + 1, 2)[:, None]
    loops = (core + 1) ** 2 + (ring - 1) * 4 * core + np.arange(0, 4 * core, 2)[None, :]
    return np.concatenate([inner, loops.ravel()])


def _halving_tets(core: int, rings: int, low: int, high: int) -> np.ndarray:
    """Seven tets over each triangle of the halved plan, up to four of the whole one."""
    triangles, fine = plan_triangles(core // 2, rings // 2), plan_triangles(core, rings)
    corners = _halved_plan(core, rings)[triangles]
    neighbours: dict[int, set[int]] = {}
    for triangle in fine.tolist():
        for node in triangle:
            neighbours.setdefault(node, set()).update(triangle)
    # What both ends of an edge have for a neighbour lies in its middle.
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    between = [neighbours[a] & neighbours[b] for a, b in ends.tolist()]
    mids = np.array([middle for (middle,) in between]).reshape(-1, 3)
    p, q, r = (triangles + low).T
    top_p, top_q, top_r = (corners + high).T
    pq, qr, rp = (mids + high).T
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
