# SPDX-License-Identifier: Apache-2.0
"""The colour of each region of a gel, in files and pictures."""

from __future__ import annotations

from taccel_lab.geometry import Region

Rgb = tuple[float, float, float]
"""Red, green and blue, 0..1, sRGB."""

REGION_COLORS: dict[Region, Rgb] = {
    Region.SIDE: (0.62, 0.64, 0.67),
    Region.CONTACT: (0.90, 0.55, 0.20),
    Region.BOND: (0.20, 0.42, 0.70),
    Region.WINDOW: (0.45, 0.78, 0.85),
}
"""Colour of each region in files and pictures."""
