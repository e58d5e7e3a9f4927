# SPDX-License-Identifier: Apache-2.0
"""Sizes in words, and what they would be if their numbers were meant in another unit."""

from __future__ import annotations

import numpy as np

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


def size_words(points_m: np.ndarray) -> str:
    """Size along x, y and z of points [m], [n, 3], in words."""
    return " x ".join(f"{1e3 * size:.4g}" for size in np.ptp(points_m, axis=0)) + " mm"
