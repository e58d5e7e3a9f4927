# SPDX-License-Identifier: Apache-2.0
"""Does a part from elsewhere have the size of a gel pad, or is its unit another one?

An STL file names no unit and a STEP file may name the wrong one, so the size decides: gel pads are
4 to 120 mm large. What does not fit is rejected with the unit it looks like, never scaled in
silence.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.errors import InputError

MM_PER_UNIT: dict[str, float] = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "in": 25.4}
"""Units that a caller may name, in millimetres."""
PLAUSIBLE_MM = (4.0, 120.0)
"""Largest extent of a gel pad [mm]."""
POSSIBLE_MM = (0.5, 1000.0)
"""Largest extent accepted of a part whose unit the caller has named [mm]."""
MIN_EXTENT_MM = 0.05
"""Least extent along any axis [mm]: thinner parts are sheets, not bodies."""

_NAMES = {"m": "metres", "in": "inches", "cm": "centimetres", "um": "micrometres"}
_SURELY_METRES = 0.5


def check_units(bounds: np.ndarray, unit: str | None = None, *, what: str = "the part") -> float:
    """Millimetres per unit of the numbers in ``bounds`` (lowest and highest corner, shape [2, 3]).

    Without ``unit`` the numbers must look like millimetres. Raises InputError with the unit that
    they look like, and for sizes that no gel pad has.
    """
    corners = np.asarray(bounds, dtype=np.float64)
    if corners.shape != (2, 3) or not np.isfinite(corners).all():
        raise InputError(f"{what} has no finite bounding box: {corners.tolist()}")
    if unit is not None and unit not in MM_PER_UNIT:
        raise InputError(f"unit {unit!r} is not allowed; use one of {', '.join(MM_PER_UNIT)}")
    scale = MM_PER_UNIT[unit or "mm"]
    extents = (corners[1] - corners[0]) * scale
    size = " x ".join(f"{e:.4g}" for e in extents)
    largest = float(extents.max())
    low, high = PLAUSIBLE_MM if unit is None else POSSIBLE_MM
    if not low <= largest <= high:
        named = f" (unit {unit})" if unit else ""
        raise InputError(
            f"{what} is {size} mm{named}; a gel pad is {low:g} to {high:g} mm large"
            + (_guess(largest) if unit is None else "; name its real unit with --unit")
        )
    if extents.min() < MIN_EXTENT_MM:
        raise InputError(
            f"{what} is {size} mm: thinner than {MIN_EXTENT_MM:g} mm along "
            f"{'xyz'[int(extents.argmin())]}, a sheet without volume"
        )
    return scale


def _guess(largest: float) -> str:
    """What an implausible largest extent looks like, and how to say so."""
    low, high = PLAUSIBLE_MM
    fitting = [unit for unit in _NAMES if low <= largest * MM_PER_UNIT[unit] <= high]
    if not fitting and largest < _SURELY_METRES:
        fitting = ["m"]
    if fitting:
        named = " or ".join(
            f"{_NAMES[unit]} ({largest * MM_PER_UNIT[unit]:.4g} mm: --unit {unit})"
            for unit in fitting
        )
        return f". The numbers look like {named}"
    for unit in ("in", "m", "cm"):
        if low <= largest / MM_PER_UNIT[unit] <= high:
            return (
                f". It looks like numbers in millimetres that were read as {_NAMES[unit]}, "
                f"{MM_PER_UNIT[unit]:g} times too large: correct the unit that the file declares, "
                "or say --unit mm if the part really is that large"
            )
    return ". Export it in millimetres, or name its unit with --unit"
