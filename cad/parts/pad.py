# SPDX-License-Identifier: Apache-2.0
"""What every gel pad provides: formulas of its surfaces, its layers.

The gel frame in millimetres: x right and y down in the tactile image, z out of the gel, origin at
the apex of the undeformed contact face. Solid (``pad_solid``), meshes, quality and tests all read
the shape from here, so that each formula stands once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from taccel_lab.cad.parameters import ParameterSet

_GRID = 200


class Pad(ParameterSet, ABC):
    """A gel body [mm]; subclasses are frozen dataclasses of ``parameter``."""

    layer_names: ClassVar[tuple[str, ...]] = ("gel",)
    """Materials of the body by layer index; 0 is the gel proper, 1 a skin over it."""

    thickness_mm: float
    """Gel under the apex, down to what it is glued to [mm]."""

    @abstractmethod
    def bounds_mm(self) -> np.ndarray:
        """Lowest and highest corner of the bounding box [mm], shape [2, 3]."""

    @abstractmethod
    def top_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        """z of the contact face over gel xy [mm], NaN beside it; [..., 2] -> [...]."""

    @abstractmethod
    def top_normal(self, xy_mm: np.ndarray) -> np.ndarray:
        """Outward unit normal of the contact face over gel xy, NaN beside it; [..., 2] ->
        [..., 3]."""

    @abstractmethod
    def inside_distance_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        """Distance in plan to the edge of the contact face [mm], positive inside;
        [..., 2] -> [...]."""

    @abstractmethod
    def contact_error_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """Distance of points from the contact face's formula [mm], [n, 3] -> [n]."""

    @abstractmethod
    def bond_projection_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """Closest points on the glued surface (bond and window) [mm], [n, 3] -> [n, 3]."""

    @abstractmethod
    def figures(self) -> dict[str, float]:
        """What a drawing states beside the parameters, such as wall heights [mm]."""

    def plan_points_mm(self) -> np.ndarray:
        """Middles of equal cells of the plan [mm], shape [200, 200, 2]."""
        low, high = self.bounds_mm()
        steps = (np.arange(_GRID) + 0.5) / _GRID
        axes = [low[k] + steps * (high[k] - low[k]) for k in range(2)]
        return np.stack(np.meshgrid(*axes), axis=-1)

    def volume_mm3(self) -> float:
        """Volume by the pad's own formula [mm^3], which mesh and CAD solid have to meet: here the
        midpoint rule over its height map."""
        low, high = self.bounds_mm()
        height = self.top_mm(self.plan_points_mm()) - low[2]
        cell = (high - low)[:2].prod() / _GRID**2
        return float(np.nansum(height) * cell)

    def layer_of(self, points_mm: np.ndarray) -> np.ndarray:
        """Index into ``layer_names`` of points inside the body, int32, [n, 3] -> [n]."""
        return np.zeros(len(points_mm), dtype=np.int32)
