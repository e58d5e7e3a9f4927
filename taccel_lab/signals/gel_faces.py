# SPDX-License-Identifier: Apache-2.0
"""The gels of a model, and pixels that fill their faces where no camera says which there are."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, Region, TetMesh
from taccel_lab.model import Model

if TYPE_CHECKING:
    from taccel_lab.signals.color_model import ColorModel

Colors = Callable[[PixelGrid], "tuple[ColorModel, np.ndarray]"]
"""Function from the pixels of a gel to its colour network and its image untouched, levels [height,
width, 3]."""
MARKERS = (8, 6)
"""Columns and rows of markers on a gel that has none."""


def bonded_gels(model: Model) -> list[int]:
    """Indices of the bonded soft bodies, which are gels; InputError where there are none."""
    found = [i for i, body in enumerate(model.scene.soft_bodies) if len(body.bonded())]
    if not found:
        raise InputError("no soft body of this scene is bonded: it has no gel to observe")
    return found


def face_grid(mesh: TetMesh | QuadraticMesh, size_px: tuple[int, int]) -> PixelGrid:
    """Pixels over the contact face of a gel at rest; they need not be square."""
    corners_mm = 1e3 * mesh.nodes_m[np.unique(mesh.region_faces(Region.CONTACT))][:, :2]
    low, high = corners_mm.min(axis=0), corners_mm.max(axis=0)
    size = np.array(size_px)
    pitch = (high - low) / size
    center = (size - 1) / 2 - (low + high) / 2 / pitch
    return PixelGrid(*size_px, *pitch.tolist(), *center.tolist())


def marker_points_mm(grid: PixelGrid) -> np.ndarray:
    """Places of the markers on a face that the pixels fill, [marker, 2]."""
    columns, rows = MARKERS
    u = (np.arange(columns) + 0.5) * grid.width_px / columns - 0.5
    v = (np.arange(rows) + 0.5) * grid.height_px / rows - 0.5
    return grid.gel_from_pixel(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
