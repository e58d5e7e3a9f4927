# SPDX-License-Identifier: Apache-2.0
"""The dimensions of a housing, without CAD: what a sensor states and a profile keeps."""

from __future__ import annotations

from dataclasses import dataclass

CLEARANCE_MM = 0.1
"""Gap beside window, gel, camera and LEDs."""
LEAST_RIM_MM = 0.4
RIM_MM = CLEARANCE_MM + LEAST_RIM_MM
"""Least of a housing beside what it holds."""


@dataclass(frozen=True)
class HousingShape:
    """The rigid body that holds window, lights and camera: a box with the gel on its front."""

    size_mm: tuple[float, float, float]
    """Outer extents along x, y and z, the cover included."""
    wall_mm: float
    corner_radius_mm: float = 1.0
    front_z_mm: float = 0.0
    """z of the front face in the gel frame [mm], at or below the back of the gel's contact face."""
    offset_mm: tuple[float, float] = (0.0, 0.0)
    """Centre of the box in gel xy."""

    @property
    def back_z_mm(self) -> float:
        """z of the back of the cover [mm]."""
        return self.front_z_mm - self.size_mm[2]
