# SPDX-License-Identifier: Apache-2.0
"""What the coating reflects at each pixel: painted markers, a turbid gel in front of it."""

from __future__ import annotations

import numpy as np

from taccel_lab.optics.frames import LightField
from taccel_lab.profile.optical_design import MarkerGrid, lattice_middle, lattice_steps

MARKER_ALBEDO = 0.05
"""Share of the coating's reflectance that is left in the middle of a marker."""


def marker_factor(grid: MarkerGrid, light: LightField) -> np.ndarray:
    """Factor on the reflectance by painted dots, one pixel soft at the edge, shape [H, W].

    Dots belong to the gel: they are looked up where the seen point was at rest.
    """
    factor = np.ones(light.mask.shape, dtype=np.float32)
    xy = light.rest_mm[light.mask][:, :2] - np.array(grid.offset_mm)
    pitch = np.array([grid.pitch_x_mm, grid.pitch_y_mm])
    middle = lattice_middle(grid.rows, grid.columns, grid.stagger)
    steps = xy @ grid.gel_from_grid() / pitch + middle
    # No dot reaches beyond half the distance of the rows, so that the nearest row holds it.
    row = np.clip(np.rint(steps[:, 1]), 0, grid.rows - 1).astype(int)
    shift = grid.stagger * (row % 2)
    column = np.clip(np.rint(steps[:, 0] - shift), 0, grid.columns - 1).astype(int)
    distance = np.linalg.norm((steps - lattice_steps(row, column, grid.stagger)) * pitch, axis=1)
    distance = np.where(grid.present()[row, column], distance, np.inf)
    cover = np.clip((grid.radius_mm - distance) / _pixel_mm(light) + 0.5, 0.0, 1.0)
    factor[light.mask] = 1 - (1 - MARKER_ALBEDO) * cover
    return factor


def _pixel_mm(light: LightField) -> float:
    """Typical size of a pixel on the face."""
    steps = np.linalg.norm(np.diff(light.rest_mm, axis=1), axis=-1)
    return float(np.nanmedian(steps)) if np.isfinite(steps).any() else 0.1


def turbid_reflectance(under: np.ndarray, optical_depth: np.ndarray) -> np.ndarray:
    """Reflectance of a scattering layer without absorption over a coating.

    ``((1 - r) s + r) / ((1 - r) s + 1)`` with the coating's reflectance r and the optical depth s =
    S t (P. Kubelka, F. Munk, "Ein Beitrag zur Optik der Farbanstriche", Z. techn. Physik 12, 1931).
    """
    gain = (1 - under) * optical_depth
    return (gain + under) / (gain + 1)
