# SPDX-License-Identifier: Apache-2.0
"""What a labelled gel must be before it is meshed: thick everywhere, whole where it is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.cad.gel_import.importer import gel_thickness
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.mesh.thickness import least_thickness
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.geometry.connectivity import compacted, piece_of_cells

MIN_THICKNESS_MM = 0.05
"""Least thickness of a body anywhere but at its edges [mm]."""


def check_gel(surface: LabelledSurface, path: Path) -> float:
    """Least thickness of the body [mm]; raises InputError, with the place, below 0.05 mm, for no
    gel between contact and bond, and for a window with holes."""
    best, where = least_thickness(surface.vertices_mm, surface.triangles)
    if best < MIN_THICKNESS_MM:
        raise InputError(
            f"{path}: the body is {best:.3g} mm thick at x {where[0]:.2f}, y {where[1]:.2f}, "
            f"z {where[2]:.2f} mm; allowed: at least {MIN_THICKNESS_MM} mm"
        )
    holes = window_holes(surface.triangles[surface.regions == int(Region.WINDOW)])
    if holes:
        raise InputError(
            f"{path}: the window has {holes} hole{'s' if holes > 1 else ''}, through which the "
            "camera would see no gel; select other faces with --window, or close what goes through"
        )
    gel = gel_thickness(surface)
    if gel < MIN_THICKNESS_MM:
        raise InputError(
            f"{path}: the highest contact point lies {gel:.3g} mm above the highest glued one; "
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
