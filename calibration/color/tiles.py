# SPDX-License-Identifier: Apache-2.0
"""Half of an image to look at, the other half to judge by: a checkerboard of tiles."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.light.smoothing import smoothed
from taccel_lab.geometry import PixelGrid

TILE_BALLS = 1 / 3
"""Side of a tile in ball radii: neighbouring pixels err alike, so that tiles are much larger than
the noise is wide; and a contact covers a dozen of them."""
MIN_TILE_PX = 6


def even_tiles(grid: PixelGrid, ball_px: float) -> np.ndarray:
    """Pixels of the even tiles, bool, shape [height_px, width_px]; the others are the odd ones."""
    side = max(MIN_TILE_PX, round(TILE_BALLS * ball_px))
    rows = np.arange(grid.height_px)[:, None] // side
    columns = np.arange(grid.width_px)[None, :] // side
    return (rows + columns) % 2 == 0


def filled_from(image: np.ndarray, background: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """``image`` where ``pixels`` is true; elsewhere the background plus the change that the pixels
    around show, as far as they reach. RGB levels, float32, shape [height_px, width_px, 3].
    """
    if pixels.all():
        return image.astype(np.float32)
    change = image.astype(np.float32) - background
    filled = np.where(pixels[..., None], change, 0.0).astype(np.float32)
    known = pixels
    # Ever wider means, so that a pixel takes the nearest that is known.
    for sigma in (1.5, 3.0, 6.0, 12.0):
        if known.all():
            break
        spread = smoothed(change, pixels, sigma)
        weight = smoothed(np.ones_like(change), pixels, sigma)[..., 0] > 0.5
        fresh = ~known & weight
        filled[fresh] = spread[fresh]
        known = known | fresh
    return (filled + background).astype(np.float32)
