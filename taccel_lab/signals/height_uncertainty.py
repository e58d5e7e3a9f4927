# SPDX-License-Identifier: Apache-2.0
"""How uncertain a height is that was integrated from uncertain slopes.

Errors of slopes add up along the way, and neighbouring pixels err together, so the standard
deviation of a height is found by trial: smooth random errors as large as the slopes' own are
integrated as the slopes were, some times, and their spread is taken. How far errors reach
(``error_length_px``) and how much too small the spread is are found on presses of known shape when
the model is calibrated.

Such errors cancel around a dent. What readings share does not: a network that was taught the rim of
the contact a pixel too far out reads every dent too steep all around. So the same errors are also
integrated as if all of them lay along the slope (``along_m``). That builds up where slopes are
uncertain, at the rim, stays over the floor of the dent and is gone beside it, as errors of real
presses do.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.slope_integration import resting_height

DRAWS = 16
"""Trials: a standard deviation from 16 is itself known to 18 %."""
POINTS_PER_LENGTH = 2.0
"""Of the grid that errors are integrated on."""
TINY_SLOPE = 1e-9
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
        # Errors that are smooth over many pixels are integrated on as many fewer of them.
        block = max(1, int(error_length_px / POINTS_PER_LENGTH))
        width, height = (max(2, round(n / block)) for n in (grid.width_px, grid.height_px))
        self._coarse = PixelGrid(
            width,
            height,
            grid.mm_per_px_x * grid.width_px / width,
            grid.mm_per_px_y * grid.height_px / height,
        )
        self._length = error_length_px * width / grid.width_px

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

        coarse = self._coarse
        sigma = self._resized(slope_sigma, coarse)
        weights, zero = self._counted(weights, zero)
        variance = np.zeros(sigma.shape)
        for field in smooth_errors(coarse.height_px, coarse.width_px, self._length):
            error = resting_height(sigma[..., None] * field, coarse, weights=weights, zero=zero)
            variance += error**2
        smoothing = SMOOTHING_PX * coarse.width_px / self.grid.width_px
        variance = gaussian_filter(variance / DRAWS, smoothing, mode="nearest")
        return np.sqrt(np.maximum(self._resized(variance, self.grid), 0.0))

    def along_m(
        self,
        slope: np.ndarray,
        slope_sigma: np.ndarray,
        *,
        weights: np.ndarray | None = None,
        zero: np.ndarray | None = None,
    ) -> np.ndarray:
        """Height [m], shape [height_px, width_px], that is gained or lost where each slope from
        rest, shape [h, w, 2], is steeper or flatter by its standard deviation; the rest as in
        ``sigma_m``."""
        steepness = np.maximum(np.linalg.norm(slope, axis=-1), TINY_SLOPE)
        error = slope * (slope_sigma / steepness)[..., None]
        weights, zero = self._counted(weights, zero)
        error = self._resized(error, self._coarse)
        height = resting_height(error, self._coarse, weights=weights, zero=zero)
        return np.abs(self._resized(height, self.grid))

    def _counted(
        self, weights: np.ndarray | None, zero: np.ndarray | None
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Weights and zero on the coarse grid."""
        if weights is not None:
            weights = np.clip(self._resized(weights, self._coarse), 0.0, 1.0)
        if zero is not None:
            zero = self._resized(zero.astype(float), self._coarse) >= 0.5
            zero = zero if zero.any() else None
        return weights, zero

    @staticmethod
    def _resized(values: np.ndarray, grid: PixelGrid) -> np.ndarray:
        """Means over larger pixels, or between the middles of larger ones."""
        import cv2

        if values.shape[:2] == (grid.height_px, grid.width_px):
            return values
        how = cv2.INTER_AREA if grid.width_px < values.shape[1] else cv2.INTER_LINEAR
        size = (grid.width_px, grid.height_px)
        return np.asarray(cv2.resize(np.asarray(values, dtype=float), size, interpolation=how))
