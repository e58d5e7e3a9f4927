# SPDX-License-Identifier: Apache-2.0
"""Pressure, force and contact of one reading, with their intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class ContactPressure:
    """What presses the gel."""

    pressure_pa: np.ndarray
    """Contact pressure [Pa], at least 0, shape [height_px, width_px] of the reading."""
    force_n: float
    """Normal force [N], its integral over the view."""
    force_interval_n: tuple[float, float] | None
    """95 % interval of the force [N]; None where the height's deviation is not known."""
    area_mm2: float
    """Area in contact [mm2]."""
    area_interval_mm2: tuple[float, float] | None
    """95 % interval of the area [mm2], likewise."""
    center_mm: tuple[float, float] | None
    """Centre of pressure in the gel frame [mm]; None without contact."""
    remarks: tuple[str, ...]
    """What the force rests on, and what is not in its interval, a sentence each."""

    @property
    def force_words(self) -> str:
        """Force and its interval in words."""
        return _with_interval(self.force_n, self.force_interval_n, "N")

    @property
    def area_words(self) -> str:
        """Area, its interval and the largest pressure in words."""
        area = _with_interval(self.area_mm2, self.area_interval_mm2, "mm2")
        return f"{area} in contact, pressure up to {1e-3 * float(self.pressure_pa.max()):.3g} kPa"

    def figures(self) -> dict[str, Any]:
        """All numbers, ready for JSON."""
        return {
            "force_n": self.force_n,
            "force_interval_n": self.force_interval_n and list(self.force_interval_n),
            "area_mm2": self.area_mm2,
            "area_interval_mm2": self.area_interval_mm2 and list(self.area_interval_mm2),
            "max_pressure_kpa": 1e-3 * float(self.pressure_pa.max()),
            "center_mm": self.center_mm and list(self.center_mm),
            "force_remarks": list(self.remarks),
        }


def _with_interval(value: float, ends: tuple[float, float] | None, unit: str) -> str:
    words = f"{value:.3g} {unit}"
    return words if ends is None else words + f" (95 %: {ends[0]:.3g} to {ends[1]:.3g} {unit})"
