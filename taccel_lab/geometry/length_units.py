# SPDX-License-Identifier: Apache-2.0
"""What a length would be if its number were meant in another unit: said where a size cannot be."""

from __future__ import annotations

_MM = {"millimetres": 1.0, "inches": 25.4, "metres": 1e3}
"""Unit -> its length [mm]."""


def other_readings(number: float, unit: str) -> str:
    """The same number as lengths in mm, read in the units other than ``unit``, of "millimetres",
    "inches" and "metres"."""
    words = [
        f"{number * length_mm:.4g} mm if its numbers are {name}"
        for name, length_mm in _MM.items()
        if name != unit
    ]
    return f"it would be {' and '.join(words)}"
