# SPDX-License-Identifier: Apache-2.0
"""Connectivity of the structured pad mesh: an O-grid plan, layers, five tets per hexahedron.

A square core of n x n cells is surrounded by rings of 4n cells. The plan is a quadrilateral mesh of
a disc and so has a two-colouring of its nodes; with the layer number added, every hexahedron is
cut into five tets whose face diagonals join nodes of the same colour, so neighbours always agree.
Nothing here depends on positions: the arrays are the same for every shape and focus.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from taccel_lab.geometry.tet_mesh import Region, boundary_faces

# Hexahedron a b c d (bottom, counter-clockwise from above), e f g h above them; each row has
# positive volume. The face diagonals join a, c, f and h.
_FIVE_TETS = np.array([[0, 1, 2, 5], [0, 2, 3, 7], [0, 4, 5, 7], [2, 5, 6, 7], [0, 2, 7, 5]])


@dataclass(frozen=True)
class GridTopology:
    """Connectivity of one O-grid with its face regions."""

    core: int
    rings: int
    layers: int
    tets: np.ndarray
    """int32, shape [5 layers cells, 4]; node = level * plan_count + plan node, level 0 below."""
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


def _plan_colors(core: int, rings: int) -> np.ndarray:
    """Two-colouring of the plan nodes (0 or 1): neighbours along cell edges differ."""
    i, j = np.meshgrid(np.arange(core + 1), np.arange(core + 1), indexing="ij")
    loop = np.arange(4 * core)
    ring_colors = [(loop + r) % 2 for r in range(1, rings + 1)]
    return np.concatenate([((i + j) % 2).ravel(), *ring_colors])


def ring_of_node(core: int, rings: int) -> np.ndarray:
    """Ring of each plan node, 0 for the core, shape [(core + 1)^2 + 4 core rings]."""
    return np.repeat(np.arange(rings + 1), [(core + 1) ** 2] + [4 * core] * rings)


@lru_cache(maxsize=16)
def grid_topology(core: int, rings: int, layers: int, window_ring: int) -> GridTopology:
    """Connectivity for a core of ``core`` x ``core`` cells, ``rings`` rings and ``layers`` layers.

    Back faces inside ring ``window_ring`` get the region WINDOW, the others BOND.
    """
    quads = plan_quads(core, rings)
    colors = _plan_colors(core, rings)
    plan_count = (core + 1) ** 2 + 4 * core * rings
    tets = []
    for layer in range(layers):
        # Rotate each cell so that its first node, and with it the diagonals, has an even colour.
        odd = (colors[quads[:, 0]] + layer) % 2 == 1
        cells = np.where(odd[:, None], np.roll(quads, -1, axis=1), quads) + layer * plan_count
        hexes = np.concatenate([cells, cells + plan_count], axis=1)
        tets.append(hexes[:, _FIVE_TETS].reshape(-1, 4))
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
