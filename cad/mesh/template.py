# SPDX-License-Identifier: Apache-2.0
"""The one template of all structured meshes: a grid that is drawn onto the surfaces of a pad.

Columns lead from the back to the contact face, level by level. Which ring and level a node has says
what the faces and tets around it belong to, so that pads and domes, even meshes and those of a
press differ only in their counts and in where a plan puts its nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.cad.mesh.grid import Grid
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.tet_mesh import tet_volumes


class FoldedMeshError(InputError):
    """A structured mesh that folds over itself."""


@dataclass(frozen=True)
class Template:
    """A grid and where one region or layer of it ends and the next begins."""

    grid: Grid
    wall: Region
    """What the outside between back and top is."""
    contact_rings: int
    """Rings of the top that are touched; those outside are the free, then the glued part of a
    wall that goes down there."""
    free_rings: int = 0
    window_rings: int = 0
    """Rings of the back that the camera looks through."""
    fillet_levels: int = 0
    """Levels of the wall, from the top, that are touched, too."""
    skin_layers: int = 0
    """Layers from the top that belong to a skin."""
    skin_rings: int = 0
    """Rings from the wall that belong to a skin."""

    def nodes_mm(self, levels_mm: np.ndarray) -> np.ndarray:
        """Nodes of the grid from those of all columns, [levels, plan nodes, 3] -> [nodes, 3]."""
        return levels_mm[self.grid.level, self.grid.plan]

    def mesh(self, nodes_mm: np.ndarray) -> TetMesh:
        """The mesh with the nodes in these places, [nodes, 3]."""
        return TetMesh(
            nodes_m=nodes_mm * 1e-3,
            tets=self.grid.tets.copy(),
            faces=self.grid.faces.copy(),
            face_regions=self._face_regions(),
            tet_layers=self._tet_layers(),
        )

    def _face_regions(self) -> np.ndarray:
        level = self.grid.level[self.grid.faces]
        ring = self.grid.ring[self.grid.faces].max(axis=1)
        lowest = level.min(axis=1)
        top, back = lowest == self.grid.layers, level.max(axis=1) == 0
        regions = np.full(len(ring), int(self.wall), dtype=np.int32)
        if self.fillet_levels:
            regions[lowest >= self.grid.layers - self.fillet_levels] = Region.CONTACT
        regions[back] = Region.BOND
        regions[back & (ring <= self.window_rings)] = Region.WINDOW
        regions[top] = Region.BOND
        regions[top & (ring <= self.contact_rings + self.free_rings)] = Region.SIDE
        regions[top & (ring <= self.contact_rings)] = Region.CONTACT
        return regions

    def _tet_layers(self) -> np.ndarray:
        lowest = self.grid.level[self.grid.tets].min(axis=1)
        innermost = self.grid.ring[self.grid.tets].min(axis=1)
        above = lowest >= self.grid.layers - self.skin_layers
        beside = innermost >= self.grid.rings - self.skin_rings
        skin = (above & (self.skin_layers > 0)) | (beside & (self.skin_rings > 0))
        return skin.astype(np.int32)


def columns_mm(back_mm: np.ndarray, top_mm: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Nodes of columns from the back to the top, each [plan nodes, 3]: [levels, plan nodes, 3].

    ``shares``: height of each level as a share of its column, 0 to 1, [levels, plan nodes or 1].
    """
    s = shares[..., None]
    return (1 - s) * back_mm + s * top_mm


def level_fractions(layers: int, ratio: np.ndarray) -> np.ndarray:
    """Height of each level over the back as a fraction, 0 to 1, shape [layers + 1, ...].

    The layer at the contact face is the thinnest; each one below is ``ratio`` [...] times as thick.
    """
    ratio = np.asarray(ratio, dtype=np.float64)
    thickness = np.stack([ratio**k for k in range(layers - 1, -1, -1)])
    below = np.concatenate([np.zeros((1, *ratio.shape)), np.cumsum(thickness, axis=0)])
    return below / below[-1]


def growth_factor(first: float, count: int) -> float:
    """Factor, at least 1, by which ``count`` steps grow from ``first`` on so that they fill 1."""
    low, high = 1.0, 2 / first
    while high - low > 1e-12 * high:
        factor = 0.5 * (low + high)
        filled = first * (factor ** np.arange(count)).sum()
        low, high = (low, factor) if filled > 1 else (factor, high)
    return low


def check_unfolded(nodes_mm: np.ndarray, tets: np.ndarray) -> None:
    """Raise FoldedMeshError with the place and the remedy where tets are flat or inside out."""
    volume = tet_volumes(nodes_mm, tets)
    if (volume <= 0).any():
        x, y, z = nodes_mm[tets[int(volume.argmin())]].mean(axis=0)
        raise FoldedMeshError(
            f"{int((volume <= 0).sum())} of {len(tets)} tets of the structured mesh fold over, the "
            f"worst at x {x:.2f}, y {y:.2f}, z {z:.2f} mm; with a focus, move it away from the "
            "edge or make its radius smaller; without one, make the window or edge_mm smaller"
        )
