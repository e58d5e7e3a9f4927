# SPDX-License-Identifier: Apache-2.0
"""The unit conversions between user-facing fields (mm, degrees) and SI values.

Works on floats and on numpy arrays alike.
"""

from __future__ import annotations

import math
from typing import TypeVar

T = TypeVar("T")


def m_from_mm(value_mm: T) -> T:
    """Millimetres to metres."""
    # Division by a power of ten is correctly rounded; a product with 1e-3 is not (1e-3 is inexact),
    # so 2.0 mm becomes exactly the double nearest to 0.002 m.
    return value_mm / 1000.0  # type: ignore[operator]


def rad_from_deg(value_deg: T) -> T:
    """Degrees to radians."""
    return value_deg * (math.pi / 180.0)  # type: ignore[operator]


def deg_from_rad(value_rad: T) -> T:
    """Radians to degrees."""
    return value_rad * (180.0 / math.pi)  # type: ignore[operator]
