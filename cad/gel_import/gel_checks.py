# SPDX-License-Identifier: Apache-2.0
"""What a gel from elsewhere must be before it is meshed: of a pad's size, thick, whole where seen.

An STL file names no unit and a STEP file may name the wrong one, so the size decides: gel pads are
4 to 120 mm large. What does not fit is rejected with the unit it looks like, never scaled in
silence.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.cad.gel_import.importer import gel_thickness
from taccel_lab.cad.mesh.surface import LabelledSurface, least_thickness
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.geometry.connectivity import compacted, piece_of_cells
from taccel_lab.guards import require_known

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
MIN_THICKNESS_MM = 0.05
"""Least thickness of a body anywhere but at its edges [mm]."""


def check_units(bounds: np.ndarray, unit: str | None = None, *, what: str = "the part") -> float:
    """Millimetres per unit of the numbers in ``bounds`` (lowest and highest corner, shape [2, 3]).

    Without ``unit`` the numbers must look like millimetres. Raises InputError with the unit that
    they look like, and for sizes that no gel pad has.
    """
    corners = np.asarray(bounds, dtype=np.float64)
    if corners.shape != (2, 3) or not np.isfinite(corners).all():
        raise InputError(f"{what} has no finite bounding box: {corners.tolist()}")
    require_known("unit", unit or "mm", MM_PER_UNIT)
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


def check_gel(surface: LabelledSurface) -> float:
    """Least thickness of the body [mm]; raises InputError, with the place, below 0.05 mm, for no
    gel between contact and bond, and for a window with holes."""
    best, where = least_thickness(surface.vertices_mm, surface.triangles)
    if best < MIN_THICKNESS_MM:
        raise InputError(
            f"the body is {best:.3g} mm thick at x {where[0]:.2f}, y {where[1]:.2f}, "
            f"z {where[2]:.2f} mm; allowed: at least {MIN_THICKNESS_MM} mm"
        )
    holes = window_holes(surface.triangles[surface.regions == int(Region.WINDOW)])
    if holes:
        raise InputError(
            f"the window has {holes} hole{'s' if holes > 1 else ''}, through which the "
            "camera would see no gel; select other faces with --window, or close what goes through"
        )
    gel = gel_thickness(surface)
    if gel < MIN_THICKNESS_MM:
        raise InputError(
            f"the highest contact point lies {gel:.3g} mm above the highest glued one; "
            f"allowed: at least {MIN_THICKNESS_MM} mm. Are contact, bond and normal right?"
        )
    return best


def window_holes(triangles: np.ndarray) -> int:
    """Holes in the pieces of a surface, by Euler's formula: a disc has V - E + F = 1."""
    nodes, packed = compacted(triangles)
    sides = np.sort(packed[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = np.unique(sides, axis=0)
    pieces = piece_of_cells(triangles).max() + 1
    return pieces - (len(nodes) - len(edges) + len(triangles))


def no_room(size_mm: tuple[float, float]) -> InputError:
    """Refusal of a window that the bond does not hold."""
    return InputError(
        f"no plane bond face, square to the normal, takes a window of {size_mm[0]:g} x "
        f"{size_mm[1]:g} mm in its middle; choose a smaller one or select window faces"
    )
