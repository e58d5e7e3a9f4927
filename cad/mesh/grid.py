# SPDX-License-Identifier: Apache-2.0
"""What all structured meshes share: an O-grid plan, layers of prisms, three tets a prism.

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

The arrays of connectivity are the same for every shape and focus. In plan the core is a bulged
square, and rings lead from it along spokes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from taccel_lab.geometry.tet_mesh import boundary_faces

_BULGE = 0.45


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


def spoke_angles(core: int) -> np.ndarray:
    """Angles of the ring nodes [rad], the first at the core's corner (-, -), shape [4 core]."""
    return -0.75 * np.pi + 2 * np.pi * np.arange(4 * core) / (4 * core)


def ring_radii(start: np.ndarray, edge: float, even: int, rings: int) -> np.ndarray:
    """Radius of every ring in the disc along every spoke, shape [rings, spokes]; the last is 1.

    The first ``even`` rings lead from ``start`` to ``edge`` in equal steps; the others grow by one
    factor.
    """
    inner = start + (edge - start) * np.arange(1, even + 1)[:, None] / even
    step = (edge - float(start.mean())) / even
    powers = np.arange(1, rings - even + 1)
    low, high = 0.05, 50.0
    for _ in range(80):
        growth = 0.5 * (low + high)
        low, high = (low, growth) if (step * growth**powers).sum() > 1 - edge else (growth, high)
    outer = edge + np.cumsum(step * low**powers)
    return np.concatenate([inner, np.tile(outer[:, None], (1, len(start)))])


def bulged_radius(theta: np.ndarray) -> np.ndarray:
    """Edge of a unit square (half width 1) bulged towards a circle, in polar form."""
    square = 1 / np.maximum(np.abs(np.cos(theta)), np.abs(np.sin(theta)))
    return (1 - _BULGE) * square + _BULGE * 1.12


@lru_cache(maxsize=16)
def bulged_core(core: int) -> np.ndarray:
    """Nodes of the unit core, equal angles on its edge, Coons patch inside: [n+1, n+1, 2]."""
    theta = spoke_angles(core)
    edge = bulged_radius(theta)[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    return coons_patch(edge, core).reshape(core + 1, core + 1, 2)


def coons_patch(loop: np.ndarray, core: int) -> np.ndarray:
    """Nodes of a core from those around it, by a Coons patch, [(core + 1)^2, 2]."""
    grid = np.zeros((core + 1, core + 1, 2))
    grid.reshape(-1, 2)[core_perimeter(core)] = loop
    u = np.linspace(0, 1, core + 1)[:, None, None]
    v = np.linspace(0, 1, core + 1)[None, :, None]
    ruled = (1 - u) * grid[:1] + u * grid[-1:] + (1 - v) * grid[:, :1] + v * grid[:, -1:]
    corner = (1 - u) * ((1 - v) * grid[0, 0] + v * grid[0, -1])
    corner = corner + u * ((1 - v) * grid[-1, 0] + v * grid[-1, -1])
    return (ruled - corner).reshape(-1, 2)
