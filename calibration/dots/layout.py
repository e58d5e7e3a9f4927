# SPDX-License-Identifier: Apache-2.0
"""A regular grid fitted to numbered dots: pitch, rotation, centre, missing dots, and how surely.

The unit is that of the points, pixels or millimetres; nothing here knows which.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.dots.lattice import Lattice
from taccel_lab.calibration.robust_fit import fit_robustly, rms, robust_scale
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import lattice_middle, lattice_steps

PITCH_X, PITCH_Y, ROTATION, CENTRE_X, CENTRE_Y = range(5)
_FAR = 5.7
"""Robust standard deviations from which on a dot is none of the grid."""
NAMES = ("pitch_x", "pitch_y", "rotation_rad", "centre_x", "centre_y")


@dataclass(frozen=True)
class LayoutFit:
    """A grid of dots: ``centre + R(rotation) (steps * pitch)``, steps counted from its middle."""

    rows: int
    columns: int
    parameters: np.ndarray
    """``NAMES`` in the points' unit, shape [5]."""
    covariance: np.ndarray
    """Shape [5, 5]."""
    stagger: float
    """Shift of odd rows in pitches along the row."""
    skew_rad: float
    """How far the angle between rows and columns is from 90 degrees; no part of the grid."""
    missing: tuple[tuple[int, int], ...]
    """Row and column of places in view without a dot."""
    residual: np.ndarray
    """Point minus grid, shape [point, 2]; NaN for points that are not numbered."""
    inlier: np.ndarray
    """Numbered points within 5.7 robust standard deviations, bool, shape [point]."""

    @property
    def pitch(self) -> tuple[float, float]:
        return float(self.parameters[PITCH_X]), float(self.parameters[PITCH_Y])

    @property
    def rotation_deg(self) -> float:
        return float(np.degrees(self.parameters[ROTATION]))

    @property
    def centre(self) -> np.ndarray:
        """Middle of the grid, shape [2]."""
        return self.parameters[CENTRE_X:]

    def sigma(self, which: int) -> float:
        """Standard deviation of a parameter."""
        return float(np.sqrt(self.covariance[which, which]))

    @property
    def residual_rms(self) -> float:
        """Root mean square distance of the inliers to the grid, per coordinate."""
        return rms(self.residual[self.inlier]) / np.sqrt(2)

    def place(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Where the grid puts dots, shape [.., 2]."""
        return _grid_points(self.parameters, self._steps(row, column))

    def _steps(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        return lattice_steps(row, column, self.stagger) - lattice_middle(
            self.rows, self.columns, self.stagger
        )


def fit_layout(
    points: np.ndarray,
    lattice: Lattice,
    *,
    covariance: np.ndarray | None = None,
    in_view: np.ndarray | None = None,
) -> LayoutFit:
    """Fit the grid by robust least squares.

    Args:
        points: Places of the dots, shape [point, 2].
        lattice: Their numbers.
        covariance: Of the points, shape [point, 2, 2]; equal weights without.
        in_view: Whether the place of each row and column lies in the picture, bool, shape [rows,
            columns]; a place out of view is not missing. All are in view without.

    Raises:
        InputError: Fewer than 4 numbered points, or all in one row or column.
    """
    numbered = np.flatnonzero(lattice.numbered)
    if len(numbered) < 4 or lattice.rows < 2 or lattice.columns < 2:
        raise InputError(
            f"a layout needs at least 4 numbered dots in 2 rows and 2 columns, got {len(numbered)} "
            f"in {lattice.rows} x {lattice.columns}"
        )
    steps = lattice.steps()[numbered] - lattice_middle(
        lattice.rows, lattice.columns, lattice.stagger
    )
    found = np.asarray(points, dtype=np.float64)[numbered]
    weight = _weights(covariance, numbered)[:, None]
    start, skew = _affine_start(steps, found)
    fit = fit_robustly(lambda p: weight * (_grid_points(p, steps) - found), start)
    miss = found - _grid_points(fit.x, steps)
    inlier = np.linalg.norm(miss, axis=1) <= _FAR * max(robust_scale(miss), 1e-9)
    residual = np.full(np.shape(points), np.nan)
    residual[numbered] = miss
    kept = np.zeros(len(residual), dtype=bool)
    kept[numbered[inlier]] = True
    return LayoutFit(
        rows=lattice.rows,
        columns=lattice.columns,
        parameters=fit.x,
        # Errors that neighbours share, as a lens makes them, go by whole rows and columns.
        covariance=fit.covariance((lattice.row[numbered], lattice.column[numbered])),
        stagger=lattice.stagger,
        skew_rad=skew,
        missing=_missing(lattice, in_view),
        residual=residual,
        inlier=kept,
    )


def _grid_points(p: np.ndarray, steps: np.ndarray) -> np.ndarray:
    x, y = steps[..., 0] * p[PITCH_X], steps[..., 1] * p[PITCH_Y]
    c, s = np.cos(p[ROTATION]), np.sin(p[ROTATION])
    return np.stack([c * x - s * y + p[CENTRE_X], s * x + c * y + p[CENTRE_Y]], axis=-1)


def _weights(covariance: np.ndarray | None, numbered: np.ndarray) -> np.ndarray:
    """Inverse standard deviations about their median: dots seen worse count less, none counts
    more than twice the usual."""
    if covariance is None:
        return np.ones(len(numbered))
    sigma = np.sqrt(np.einsum("nii->n", covariance[numbered]) / 2)
    usual = float(np.median(sigma))
    return usual / np.maximum(sigma, 0.5 * usual) if usual > 0 else np.ones(len(numbered))


def _affine_start(steps: np.ndarray, found: np.ndarray) -> tuple[np.ndarray, float]:
    """Grid nearest to the affine fit, and the skew that it leaves out."""
    design = np.column_stack([steps, np.ones(len(steps))])
    a, b, centre = np.linalg.lstsq(design, found, rcond=None)[0]
    along = np.arctan2(a[1], a[0])
    across = np.arctan2(-b[0], b[1])
    skew = float((across - along + np.pi) % (2 * np.pi) - np.pi)
    start = np.array([np.hypot(*a), np.hypot(*b), along + 0.5 * skew, *centre])
    return start, skew


def _missing(lattice: Lattice, in_view: np.ndarray | None) -> tuple[tuple[int, int], ...]:
    present = np.zeros((lattice.rows, lattice.columns), dtype=bool)
    numbered = lattice.numbered
    present[lattice.row[numbered], lattice.column[numbered]] = True
    absent = ~present if in_view is None else ~present & in_view
    return tuple((int(r), int(c)) for r, c in zip(*np.nonzero(absent), strict=True))
