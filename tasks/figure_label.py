# SPDX-License-Identifier: Apache-2.0
"""Names of figures as people read them."""

from __future__ import annotations

UNITS = {
    "mm": "mm", "mm2": "mm²", "m": "m", "n": "N", "px": "px", "deg": "deg", "s": "s", "pa": "Pa",
    "kpa": "kPa", "mpa": "MPa", "percent": "%",
}  # fmt: skip
"""Last words of names that are units."""


def figure_label(name: str) -> str:
    """``slip_on_plane_mm`` as "slip on plane [mm]"."""
    *words, last = name.split("_")
    if words and last in UNITS:
        return f"{' '.join(words)} [{UNITS[last]}]"
    return name.replace("_", " ")
