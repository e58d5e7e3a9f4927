# SPDX-License-Identifier: Apache-2.0
"""The rim band of a rounded rectangle that is wider than the corner radius, or as wide.

The band leads along straight rays from the inner outline, inset by the band's width, to the wall.
Where the band is wider than the corner radius the inner outline has sharp corners and the rays fan
out from them, so that the rim stays smooth across the diagonals, as a cast gel is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RimBand:
    """A band along the edge of a rounded rectangle [mm]."""

    half_x_mm: float
    half_y_mm: float
    corner_radius_mm: float
    width_mm: float

    def fraction_and_foot(self, xy_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where points lie in the band: 0 on and inside the inner outline, 1 on the wall, [...].

        Also their foot [mm]: the begin of their ray on the inner outline, or the point itself when
        it lies inside; [..., 2].
        """
        xy = np.asarray(xy_mm, dtype=np.float64)
        r, b = self.corner_radius_mm, self.width_mm
        reach = max(r, b)
        core = np.array([self.half_x_mm - reach, self.half_y_mm - reach])
        q = np.abs(xy) - core
        length = np.linalg.norm(np.maximum(q, 0), axis=-1)
        in_corner = q.min(axis=-1) > 0
        unit = np.maximum(q, 0) / np.maximum(length, 1e-300)[..., None]
        wall = np.where(in_corner, self._to_wall_mm(unit, reach), reach)
        inner = max(r - b, 0.0)
        fraction = np.maximum(length - inner, 0) / (wall - inner)
        foot = np.minimum(q, 0) + np.minimum(length, inner)[..., None] * unit
        return fraction, (core + foot) * np.where(xy < 0, -1.0, 1.0)

    def _to_wall_mm(self, unit: np.ndarray, reach: float) -> np.ndarray:
        """Distance from the core's corner to the wall in the direction ``unit`` [..., 2]."""
        r = self.corner_radius_mm
        center = reach - r
        # Straight walls first: each ray meets the nearer of both lines, or the arc between them.
        line = reach / np.maximum(unit.max(axis=-1), 1e-300)
        other = line * unit.min(axis=-1)
        along = center * unit.sum(axis=-1)
        arc = along + np.sqrt(np.maximum(along**2 - 2 * center**2 + r**2, 0))
        return np.where(other <= center, line, arc)
