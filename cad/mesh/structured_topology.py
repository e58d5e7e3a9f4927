# SPDX-License-Identifier: Apache-2.0
"""Connectivity of the structured pad mesh: an O-grid plan, layers, three tets per prism.

A square core of n x n cells is surrounded by rings of 4n cells. Every cell of the plan is cut along
the same diagonal, so that inner surface nodes have six triangles each. Each prism over a triangle
is cut into three tets by the order of its plan nodes, so neighbours always agree. Five tets per
hexahedron, with diagonals that alternate, have fewer and rounder tets, but their surface nodes have
four and eight triangles in turn, and in a nearly incompressible gel of linear tets that pattern
shows: on a press of a 2 mm ball the contact pressure alternated between 50 and 250 kPa from node to
node where this split gives a smooth field. Nothing here depends on positions: the arrays are the
same for every shape and focus.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from taccel_lab.geometry.tet_mesh import Region, boundary_faces


@dataclass(frozen=True)
class GridTopology:
    """Connectivity of one O-grid with its face regions."""

    core: int
    rings: int
    layers: int
    tets: np.ndarray
    """int32, shape [6 layers cells, 4]; node = level * plan_count + plan node, level 0 below."""
    faces: np.ndarray
    """Boundary triangles, int32, shape [face_count, 3]."""
    face_regions: np.ndarray
    """``Region`` of each face, int32, shape [face_count]."""

    @property
    def plan_count(self) -> int:
        return (self.core + 1) ** 2 + 4 * self.core * self.rings


def core_perimeter(core: int) -> np.ndarray:
    """Nodes on the edge of the core, counter-clockwise from the corner (-, -)."""
    n = np.arange(core)
    i = np.concatenate([n, np.full(core, core), core - n, np.zeros(core, dtype=int)])
    j = np.concatenate([np.zeros(core, dtype=int), n, np.full(core, core), core - n])
    return i * (core + 1) + j


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
    """Ring of each plan node, 0 for the core, shape [(core + 1)^2 + 4 core rings]."""
    return np.repeat(np.arange(rings + 1), [(core + 1) ** 2] + [4 * core] * rings)


def prism_tets(triangles: np.ndarray, low: int, high: int) -> np.ndarray:
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


@lru_cache(maxsize=16)
def grid_topology(
    core: int, rings: int, layers: int, window_ring: int, mirrored: bool = False
) -> GridTopology:
    """Connectivity for a core of ``core`` x ``core`` cells, ``rings`` rings and ``layers`` layers.

    Back faces inside ring ``window_ring`` get the region WINDOW, the others BOND. ``mirrored`` is
    that of ``plan_triangles``.
    """
    triangles = plan_triangles(core, rings, mirrored)
    plan_count = (core + 1) ** 2 + 4 * core * rings
    tets = [
        prism_tets(triangles, layer * plan_count, (layer + 1) * plan_count)
        for layer in range(layers)
    ]
    all_tets = np.concatenate(tets).astype(np.int32)
    faces = boundary_faces(all_tets)
    regions = _face_regions(faces, core, layers, plan_count, window_ring)
    for array in (all_tets, faces, regions):
        array.setflags(write=False)
    return GridTopology(core, rings, layers, all_tets, faces, regions)


def _face_regions(
    faces: np.ndarray, core: int, layers: int, plan_count: int, window_ring: int
) -> np.ndarray:
    level, plan = np.divmod(faces, plan_count)
    ring = ring_of_node(core, (plan_count - (core + 1) ** 2) // (4 * core))[plan]
    top, bottom = (level == layers).all(axis=1), (level == 0).all(axis=1)
    inside = ring.max(axis=1) <= window_ring
    regions = np.full(len(faces), int(Region.SIDE), dtype=np.int32)
    regions[top] = Region.CONTACT
    regions[bottom & inside] = Region.WINDOW
    regions[bottom & ~inside] = Region.BOND
    return regions
