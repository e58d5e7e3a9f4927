# SPDX-License-Identifier: Apache-2.0
"""How uncertain a height is that was integrated from uncertain slopes.

Errors of slopes add up along the way, and neighbouring pixels err together, so the standard
deviation of a height is found by trial: smooth random errors as large as the slopes' own are
integrated as the slopes were, some times, and their spread is taken. How far errors reach
(``error_length_px``) and how much too small the spread is are found on presses of known shape when
the model is calibrated.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.slope_integration import height_from_slopes

DRAWS = 16
"""Trials: a standard deviation from 16 is itself known to 18 %."""
SMOOTHING_PX = 6.0
"""The spread of few trials is uneven; its square is averaged over this many pixels."""


@lru_cache(maxsize=4)
def smooth_errors(height_px: int, width_px: int, length_px: float) -> np.ndarray:
    """Fields of unit variance that are smooth over ``length_px``, the same for every image,
    float32, shape [draw, height_px, width_px, 2]."""
    from scipy.ndimage import gaussian_filter

    fields = np.random.default_rng(0).standard_normal(
        (DRAWS, height_px, width_px, 2), dtype=np.float32
    )
    if length_px > 0:
        fields = gaussian_filter(fields, (0, length_px, length_px, 0), mode="reflect")
    return fields / fields.std(axis=(0, 1, 2))


class HeightUncertainty:
    """Standard deviations of integrated heights on one pixel grid."""

    def __init__(self, grid: PixelGrid, error_length_px: float) -> None:
        """
        Args:
            grid: The pixel grid of the slopes.
            error_length_px: Standard deviation of the Gaussian that errors are smooth over [px].
        """
        self.grid, self.error_length_px = grid, error_length_px

    def sigma_m(
        self,
        slope_sigma: np.ndarray,
        *,
        weights: np.ndarray | None = None,
        zero: np.ndarray | None = None,
    ) -> np.ndarray:
        """Standard deviation of the height [m], shape [height_px, width_px].

        Args:
            slope_sigma: Standard deviation of each component of the slope, shape [h, w].
            weights: As the heights were integrated with.
            zero: Pixels that the height is counted from, likewise.
        """
        from scipy.ndimage import gaussian_filter

        variance = np.zeros(slope_sigma.shape)
        grid = self.grid
        for field in smooth_errors(grid.height_px, grid.width_px, self.error_length_px):
            error = height_from_slopes(
                slope_sigma[..., None] * field, grid, weights=weights, zero=zero
            )
            variance += error**2
        return np.sqrt(gaussian_filter(variance / DRAWS, SMOOTHING_PX, mode="nearest"))
