# SPDX-License-Identifier: Apache-2.0
"""How far a contact moves over a gel: its mesh has to be fine where it goes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ContactSweep:
    """Motion of a tool over the gel after it has come down, in the gel frame."""

    shear_mm: tuple[float, float] = (0.0, 0.0)
    """Way of the tool's origin."""
    twist_deg: float = 0.0
    """Turn about +z through the origin, right-handed."""
    slip: float = 1.0
    """Share of that motion that is slip; for the rest the gel sticks to the tool."""

    @property
    def drags(self) -> bool:
        """True where the gel sticks to the tool for a part of a way."""
        return self.slip < 1 and (any(self.shear_mm) or self.twist_deg != 0)

    @property
    def way_mm(self) -> np.ndarray:
        """Way of the origin over the gel, [2]."""
        return self.slip * np.asarray(self.shear_mm, dtype=np.float64)

    @property
    def length_mm(self) -> float:
        """Length of that way."""
        return float(np.linalg.norm(self.way_mm))

    def moved(self, points_mm: np.ndarray) -> np.ndarray:
        """Points of a tool, [n, 2], where they lie on the gel at the end."""
        angle = math.radians(self.slip * self.twist_deg)
        c, s = math.cos(angle), math.sin(angle)
        return points_mm @ [[c, s], [-s, c]] + self.way_mm


AT_REST = ContactSweep()
