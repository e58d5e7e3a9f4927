# SPDX-License-Identifier: Apache-2.0
"""Which row and column of a lattice each of many points is, and the regular grid nearest to them.

The unit is that of the points, pixels or millimetres; nothing here knows which.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.guards import require_shape
from taccel_lab.profile.optical_design import lattice_middle, lattice_steps
from taccel_lab.reading.dots.lattice_growth import (
    TURNS,
    largest_growth,
    mean_steps,
    shortest_basis,
    turned_to_image,
)
from taccel_lab.robust_fit import fit_robustly, rms, robust_scale

Kind = Literal["rectangular", "hexagonal", "none"]

_LEAST = 6
"""Points that a lattice has at least."""
_REGULAR = 0.12
"""Largest median error, in pitches, of predicting a point from its neighbours."""
_FAR = 5.7
"""Robust standard deviations from which on a dot is none of the grid."""
PITCH_X, PITCH_Y, ROTATION, CENTRE_X, CENTRE_Y = range(5)


@dataclass(frozen=True)
class Lattice:
    """Numbered points."""

    row: np.ndarray
    """Row of each point, from 0 downwards, -1 for none, int, shape [point]."""
    column: np.ndarray
    """Column of each point, from 0 rightwards, -1 for none, int, shape [point]."""
    kind: Kind
    """Hexagonal: rows are alternately shifted by half a pitch, see ``stagger``."""
    stagger: float
    """Shift of odd rows in pitches along the row: 0, or +-0.5 in a hexagonal lattice."""
    irregularity: float
    """Median error, in pitches, of predicting a point from the points around it."""

    @property
    def rows(self) -> int:
        return int(self.row.max(initial=-1)) + 1

    @property
    def columns(self) -> int:
        return int(self.column.max(initial=-1)) + 1

    @property
    def numbered(self) -> np.ndarray:
        """Points that belong to the lattice, bool, shape [point]."""
        return self.row >= 0

    @property
    def count(self) -> int:
        """How many points are numbered."""
        return int(self.numbered.sum())

    def steps(self) -> np.ndarray:
        """Columns and rows as numbers, with the shift of odd rows, float, shape [point, 2]."""
        return lattice_steps(self.row, self.column, self.stagger)


def renumbered(lattice: Lattice, keep: np.ndarray) -> tuple[Lattice, tuple[int, int]]:
    """The lattice of some of its points, counted from their own outermost row and column.

    Args:
        lattice: Numbered points.
        keep: Which points stay numbered, bool, shape [point].

    Returns:
        The lattice, and which row and column of the old one are its first.
    """
    stays = lattice.numbered & keep
    row, column = np.where(stays, lattice.row, -1), np.where(stays, lattice.column, -1)
    if not stays.any():
        return replace(lattice, row=row, column=column), (0, 0)
    first = int(row[stays].min()), int(column[stays].min())
    row[stays] -= first[0]
    column[stays] -= first[1]
    # Odd and even rows swap when an odd number of rows went: what started further right now
    # starts further left.
    stagger = -lattice.stagger if first[0] % 2 else lattice.stagger
    return replace(lattice, row=row, column=column, stagger=stagger), first


def lattice_index(points: np.ndarray) -> Lattice:
    """Number the points of a square, rectangular or hexagonal lattice, in any order.

    Args:
        points: Places such as dot centres (u, v), shape [point, 2]; some may be missing, some
            may belong to no lattice.

    Returns:
        Rows count downwards (v), columns rightwards (u), both from 0 at the outermost numbered
        dot; the row direction is the lattice direction nearest to +u. ``kind`` is ``none`` and all
        numbers -1 where no lattice of at least 6 points explains half of the points.

    Raises:
        InputError: Not finite, or not of shape [point, 2].
    """
    points = np.asarray(points, dtype=np.float64)
    require_shape("points", points, ("point", 2))
    best = largest_growth(points) if len(points) >= _LEAST else None
    if best is not None:
        errors = best.errors()
        best = replace(best, numbered=best.numbered & ~(errors > 2.5 * _REGULAR))
        irregularity = float(np.median(errors[np.isfinite(errors)])) if best.count else np.inf
        enough = best.count >= max(_LEAST, 0.5 * len(points)) and irregularity <= _REGULAR
        if enough and best.spans_the_plane:
            index, kind, stagger = _canonical(best.index[best.numbered], points[best.numbered])
            column, row = np.full((2, len(points)), -1)
            column[best.numbered], row[best.numbered] = index.T
            return Lattice(row, column, kind, stagger, irregularity)
    none = np.full(len(points), -1)
    return Lattice(none, none, "none", 0.0, np.inf)


def _canonical(index: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, Kind, float]:
    """Turn and flip a numbering, index and points [n, 2], so that columns run right and rows down.

    Returns:
        Columns and rows, from 0, shape [n, 2], the kind of the lattice and its stagger.
    """
    change, basis = shortest_basis(mean_steps(index, points))
    cosine = float(basis[0] @ basis[1] / np.prod(np.linalg.norm(basis, axis=1)))
    ratio = float(np.divide(*np.linalg.norm(basis, axis=1)))
    hexagonal = abs(cosine) > 0.34 and 0.75 < ratio < 1.33
    changes = TURNS
    if hexagonal:
        # The two shortest steps and the one between them, either way.
        ways = np.array([(1, 0), (0, 1), (1, -1) if cosine > 0 else (1, 1)])
        pairs = itertools.permutations([*ways, *-ways], 2)
        changes = [pair for a, b in pairs if abs(np.linalg.det(pair := np.array([a, b]))) > 0.5]
    turn = turned_to_image(basis, changes)
    basis, change = turn @ basis, turn @ change
    new = np.rint(index @ np.linalg.inv(change)).astype(int)
    new -= new.min(axis=0)
    if not hexagonal:
        return new, "rectangular", 0.0
    # A step across the rows goes half a pitch along them too; counted back in every second row.
    half = new[:, 1] / 2
    new[:, 0] += (np.floor(half) if basis[0] @ basis[1] > 0 else -np.ceil(half)).astype(int)
    # Whether odd rows start to the right or to the left of even ones: what needs fewer columns.
    stagger, other = 0.5, new[:, 0] + new[:, 1] % 2
    if np.ptp(other) < np.ptp(new[:, 0]):
        new[:, 0], stagger = other, -0.5
    new[:, 0] -= new[:, 0].min()
    return new, "hexagonal", stagger


@dataclass(frozen=True)
class LayoutFit:
    """A grid of dots: ``centre + R(rotation) (steps * pitch)``, steps counted from its middle."""

    rows: int
    columns: int
    parameters: np.ndarray
    """Pitches, rotation [rad] and centre in the points' unit, ``PITCH_X`` to ``CENTRE_Y``, [5]."""
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
        steps = lattice_steps(row, column, self.stagger)
        middle = lattice_middle(self.rows, self.columns, self.stagger)
        return _grid_points(self.parameters, steps - middle)


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
