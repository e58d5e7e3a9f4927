# SPDX-License-Identifier: Apache-2.0
"""Where a surface faces that was read from an image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.reading.on_pixels import on_pixels, repeated
from taccel_lab.reading.slopes import NormalMap
from taccel_lab.signals.normals import normals_from_height


@dataclass(frozen=True)
class Directions:
    """Where a surface faces; the last three are None of a grey sensor."""

    normals: np.ndarray
    """Outward unit normals, shape [height_px, width_px, 3]."""
    sigma_deg: np.ndarray | None = None
    """Standard deviation of each component of the tilt [degrees]."""
    radius95_deg: np.ndarray | None = None
    """Angle within which 95 % of the true normals lie [degrees]."""
    beyond_balls: np.ndarray | None = None
    """Pixels that read steeper than any captured ball was, bool: their slopes are what the colour
    model makes of colours that nobody captured."""


def directions_of_blocks(
    read: NormalMap[np.ndarray],
    config: NormalModelConfig,
    beyond: np.ndarray,
    shape: tuple[int, ...],
    block_px: int,
) -> Directions:
    """Directions of all pixels, of what a model of ``config`` read of blocks of so many, and of
    their steep places."""
    lean_deg = np.degrees(np.hypot(*np.moveaxis(read.tilt_rad, -1, 0)))
    sigma_deg = np.hypot(read.sigma_deg, config.unit_share * lean_deg)
    fine, fine_deg = on_pixels([read.normals, sigma_deg], shape, block_px)
    fine = fine / np.sqrt(np.einsum("hwc,hwc->hw", fine, fine))[..., None]
    fine_deg = np.maximum(fine_deg, sigma_deg.min())
    steep = repeated(beyond, block_px, shape)
    return Directions(fine, fine_deg, config.radius95_sigmas * fine_deg, steep)


def directions_of_heights(height_m: np.ndarray, grid: PixelGrid) -> Directions:
    """Directions of a grey sensor's surface, whose heights [m] [h, w] are read by themselves."""
    return Directions(normals_from_height(height_m, grid))
