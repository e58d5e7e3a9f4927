# SPDX-License-Identifier: Apache-2.0
"""Heights from one image by an inverse model: its slopes integrated, and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.height_uncertainty import HeightUncertainty
from taccel_lab.signals.normal_model import NormalMap, NormalModel
from taccel_lab.signals.slope_integration import resting_height

BAND_SIGMAS = 2.0
"""Standard deviations within which 95 % of the heights lie."""
FLAT_SIGMAS = 2.0
"""Tilts below this many standard deviations count as at rest."""
FLAT_DEG = 3.0
"""Tilts below this angle do anyway."""


@dataclass(frozen=True)
class ReadHeights:
    """What an image shows of the surface."""

    normals: NormalMap
    slope: np.ndarray
    """dh/dx and dh/dy over those at rest, shape [height_px, width_px, 2]."""
    rise_m: np.ndarray
    """Rise over the resting face [m], shape [height_px, width_px]."""
    zero: np.ndarray | None
    """Pixels at rest that it is counted from, bool; None for the whole border."""
    sigma_m: np.ndarray | None
    """Its standard deviation [m], by the reading and by what the model's calibration may be off by;
    None where the model does not know."""
    reading_sigma_m: np.ndarray | None
    """That of the reading alone, which tells places of one image apart."""


def read_heights(
    model: NormalModel,
    image: np.ndarray,
    background: np.ndarray,
    grid: PixelGrid,
    *,
    mask: np.ndarray | None = None,
    rest_normals: np.ndarray | None = None,
    left_out: int | None = None,
    uncertainty: bool = True,
    every: int = 1,
) -> ReadHeights:
    """Read one image.

    Args:
        model: From colours to normals.
        image: RGB levels under the background's light, shape [height_px, width_px, 3].
        background: The untouched sensor, same shape.
        grid: Pixel grid of both.
        mask: Pixels that count, bool, shape [h, w]; the surface goes on smoothly under the others.
        rest_normals: Outward unit normals of the undeformed face, shape [h, w, 3]; flat when None.
        left_out: The member that reads alone, since it did not see this press (``NormalModel``).
        uncertainty: Whether to find the heights' standard deviation, a third of the time.
        every: Only every so many-th row and column is read, as in the whole image, and integrated:
            the maps are those of ``grid.thinned(every)``.
    """
    found = model.predict(
        image, background, mask=mask, rest_normals=rest_normals, left_out=left_out, every=every
    )
    part = np.s_[::every, ::every]
    grid = grid.thinned(every)
    mask = None if mask is None else mask[part]
    rest_normals = None if rest_normals is None else rest_normals[part]
    weights = None if mask is None else mask.astype(float)
    zero = resting_border(found, mask)
    slope = found.slopes()
    if rest_normals is not None:
        # The change of height from rest is integrated: on a curved gel the rest is known already.
        slope = slope + rest_normals[..., :2] / rest_normals[..., 2:]
    rise = resting_height(slope, grid, weights=weights, zero=zero)
    sigma = reading = None
    if uncertainty and model.config.height_factor > 0:
        config, slope_sigma = model.config, found.slope_sigma()
        trials = HeightUncertainty(grid, config.error_length_px / every)
        reading = config.height_factor * trials.sigma_m(slope_sigma, weights=weights, zero=zero)
        along = trials.along_m(slope, slope_sigma, weights=weights, zero=zero)
        sigma = np.hypot(
            reading, np.hypot(config.along_factor * along, config.depth_share * np.abs(rise))
        )
    return ReadHeights(found, slope, rise, zero, sigma, reading)


def resting_border(found: NormalMap, mask: np.ndarray | None = None) -> np.ndarray | None:
    """Border pixels that are flat, bool, shape [h, w]; None (the whole border) where next to none
    are."""
    tilt_deg = np.degrees(np.linalg.norm(found.tilt_rad, axis=-1))
    flat = tilt_deg < np.maximum(FLAT_DEG, FLAT_SIGMAS * found.sigma_deg)
    rows, columns = tilt_deg.shape
    depth = max(2, min(rows, columns) // 20)
    flat[depth:-depth, depth:-depth] = False
    if mask is not None:
        flat &= mask
    return flat if flat.sum() > 0.2 * (rows + columns) else None
