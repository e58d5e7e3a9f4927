# SPDX-License-Identifier: Apache-2.0
"""What a smooth model of the plane leaves at the board's points, as a thin-plate spline.

Pressed dots are displaced by the gel, and no lens model is exact: the spline takes up what is left
and smooth, with a smoothing chosen by leaving points out (PRESS; F. Bookstein, "Principal warps",
IEEE Trans. PAMI 11, 1989, for the spline).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator

_SMOOTHINGS = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Tried, in units of the board's pitch."""
_BETTER = 0.98
"""The held-out error must fall below this share of what it is without a spline."""
_EXACT_PX = 1e-6
_MOST_POINTS = 600


@dataclass(frozen=True)
class Correction:
    """A spline from the plane [mm] to a displacement [px]."""

    points_mm: np.ndarray
    """Shape [n, 2]."""
    residuals_px: np.ndarray
    unit_mm: float
    smoothing: float
    heldout_px: float
    """What it leaves at points that it has not seen, but the model under it has."""

    def __call__(self, xy_mm: np.ndarray) -> np.ndarray:
        """Displacement [px] of points, [n, 2] -> [n, 2]."""
        return self._spline(self.residuals_px)(np.asarray(xy_mm) / self.unit_mm)

    def weights(self, xy_mm: np.ndarray) -> np.ndarray:
        """How much each residual counts at some points, shape [points, n]."""
        return self._spline(np.eye(len(self.points_mm)))(np.asarray(xy_mm) / self.unit_mm)

    def _spline(self, values: np.ndarray) -> RBFInterpolator:
        return RBFInterpolator(
            self.points_mm / self.unit_mm, values, smoothing=self.smoothing, degree=1
        )


def fit_correction(
    points_mm: np.ndarray, residuals_px: np.ndarray, unit_mm: float
) -> Correction | None:
    """The spline that predicts points left out best, or None where nothing smooth is left.

    Args:
        points_mm: Points on the plane, shape [n, 2].
        residuals_px: Seen minus modelled there, shape [n, 2].
        unit_mm: Pitch of the board.
    """
    count = len(points_mm)
    without = float(np.sqrt(np.mean(np.sum(residuals_px**2, axis=1))))
    if count < 12 or count > _MOST_POINTS or without < _EXACT_PX:
        return None
    best = None
    for smoothing in _SMOOTHINGS:
        trial = Correction(points_mm, residuals_px, unit_mm, smoothing, np.inf)
        hat = trial.weights(points_mm)
        left = (residuals_px - hat @ residuals_px) / (1.0 - np.diag(hat))[:, None]
        error = float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
        if best is None or error < best.heldout_px:
            best = Correction(points_mm, residuals_px, unit_mm, smoothing, error)
    return best if best is not None and best.heldout_px < _BETTER * without else None
