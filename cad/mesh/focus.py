# SPDX-License-Identifier: Apache-2.0
"""Where and how finely a structured mesh resolves a contact, and the rings that do so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.cad.mesh.contact_plan import ContactOutline
from taccel_lab.cad.mesh.grid import bulged_core, bulged_radius, ring_radii, spoke_angles
from taccel_lab.errors import InputError
from taccel_lab.guards import require_range

MIN_FOCUS_EDGE_MM = 1.5
"""Least distance along the contact face between a contact and its edge [mm]."""
_LIMITS = {"core": (4, 64), "rings": (3, 128), "layers": (1, 64)}


@dataclass(frozen=True)
class FocusOptions:
    """Where and how finely a mesh resolves a contact; counts alone set the connectivity."""

    at_mm: tuple[float, float]
    """Gel xy of the contact."""
    radius_mm: float
    """Radius of the fine part."""
    size_mm: float
    """Element size in the fine part."""
    core: int = 12
    rings: int = 20
    layers: int = 4
    layer_ratio: float = 1.5
    """Thickness of a layer over that of the one above it, at the contact."""
    outlines: tuple[ContactOutline, ContactOutline] | None = None
    """What the rings follow around the contact instead of circles, at the contact face and at the
    back; on a dome in the plane that touches it there."""
    lean: float = 1.0
    """Power of the depth by which columns lean from the face's plan to the back's; above 1 they
    are steeper where the layers are thin."""

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            if not isinstance(value, int) or not low <= value <= high:
                raise InputError(
                    f"{name} = {value!r} is not allowed; use a whole number {low}..{high}"
                )
        if self.core % 2:
            raise InputError(f"core = {self.core} is odd; use an even number: its corners match")
        if np.shape(self.at_mm) != (2,) or not np.isfinite(self.at_mm).all():
            raise InputError(f"at_mm = {self.at_mm!r} is not a pair of numbers (x, y) in mm")
        require_range("layer_ratio", self.layer_ratio, 1.0, 4.0)

    def check_size(self, largest_mm: float) -> None:
        """Raise InputError for a fine part that is larger than the contact face or has no cells."""
        require_range("radius_mm", self.radius_mm, 0.05, largest_mm)
        require_range("size_mm", self.size_mm, 0.01, self.radius_mm)


def graded_rings(
    focus: FocusOptions, rings: int, per_mm: float, *, largest_half: float, most_even: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """The grid around a focus in the unit disc: even inside the focus, growing from there to 1.

    ``per_mm`` is the scale from the contact face to the disc. The core keeps the wanted cells up
    to the half width ``largest_half``, and at most ``most_even`` rings fill the focus.

    Returns the core's nodes, complex, [(core + 1)^2], the radii of the rings along the spokes,
    [rings, 4 core], and how many of them are even.
    """
    half = min(focus.core * focus.size_mm / 2 * per_mm, largest_half)
    size = 2 * half / focus.core
    start = half * bulged_radius(spoke_angles(focus.core))
    wanted = round((focus.radius_mm * per_mm - half) / size)
    # At least half of the core's half width, so that the first ring clears the core's corners.
    even = int(np.clip(wanted, np.ceil(focus.core / 4), max(1, most_even)))
    reach = float(np.clip(half + even * size, 1.5 * half, 0.7))
    core = half * (bulged_core(focus.core) @ np.array([1, 1j])).ravel()
    return core, ring_radii(start, reach, even, rings), even
