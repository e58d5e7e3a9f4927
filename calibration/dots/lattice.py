# SPDX-License-Identifier: Apache-2.0
"""Which row and column of a lattice each of many points is."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from taccel_lab.calibration.dots.lattice_growth import (
    TURNS,
    Growth,
    largest_growth,
    mean_steps,
    shortest_basis,
    turned_to_image,
)
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import lattice_steps

Kind = Literal["rectangular", "hexagonal", "none"]

_LEAST = 6
"""Points that a lattice has at least."""
_REGULAR = 0.12
"""Largest median error, in pitches, of predicting a point from its neighbours."""


@dataclass(frozen=True)
class Lattice:
    """Numbered points."""

    row: np.ndarray
    """Row of each point, from 0 downwards, -1 for none, int, shape [point]."""
    column: np.ndarray
    """Column of each point, from 0 rightwards, -1 for none, int, shape [point]."""
    kind: Kind
    """Hexagonal: rows are alternately shifted by half a pitch, see ``stagger``."""
    basis: np.ndarray
    """Steps to the next column and the next row, (u, v), shape [2, 2]; without the shift of a
    hexagonal lattice's rows."""
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
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise InputError(f"points must be finite, shape [point, 2], got {points.shape}")
    best = largest_growth(points) if len(points) >= _LEAST else None
    if best is None:
        return _nothing(len(points))
    errors = best.errors()
    best = best.without(errors > 2.5 * _REGULAR)
    irregularity = float(np.median(errors[np.isfinite(errors)])) if best.count else np.inf
    enough = best.count >= max(_LEAST, 0.5 * len(points)) and irregularity <= _REGULAR
    return (
        _canonical(best, irregularity) if enough and best.spans_the_plane else _nothing(len(points))
    )


def _nothing(count: int) -> Lattice:
    none = np.full(count, -1)
    return Lattice(none, none.copy(), "none", np.full((2, 2), np.nan), 0.0, np.inf)


def _canonical(growth: Growth, irregularity: float) -> Lattice:
    """Turn and flip the numbering so that columns run right and rows down, and count from 0."""
    points, numbered = growth.points, growth.numbered
    change, basis = shortest_basis(mean_steps(growth.index[numbered], points[numbered]))
    kind, stagger = "rectangular", 0.0
    cosine = float(basis[0] @ basis[1] / np.prod(np.linalg.norm(basis, axis=1)))
    ratio = float(np.divide(*np.linalg.norm(basis, axis=1)))
    if abs(cosine) > 0.34 and 0.75 < ratio < 1.33:
        kind = "hexagonal"
    changes = TURNS
    if kind == "hexagonal":
        # The two shortest steps and the one between them, either way.
        ways = np.array([(1, 0), (0, 1), (1, -1) if cosine > 0 else (1, 1)])
        pairs = itertools.permutations([*ways, *-ways], 2)
        changes = [pair for a, b in pairs if abs(np.linalg.det(pair := np.array([a, b]))) > 0.5]
    turn = turned_to_image(basis, changes)
    basis, change = turn @ basis, turn @ change
    new = np.rint(growth.index[numbered] @ np.linalg.inv(change)).astype(int)
    new -= new.min(axis=0)
    if kind == "hexagonal":
        # A step across the rows goes half a pitch along them too; counted back in every second row.
        lean = 0.5 * np.sign(float(basis[0] @ basis[1]))
        half = new[:, 1] / 2
        new[:, 0] += (np.floor(half) if lean > 0 else -np.ceil(half)).astype(int)
        basis = np.stack([basis[0], basis[1] - lean * basis[0]])
        stagger = 0.5
        # Whether odd rows start to the right or to the left of even ones: what needs fewer columns.
        other = new[:, 0] + new[:, 1] % 2
        if np.ptp(other) < np.ptp(new[:, 0]):
            new[:, 0], stagger = other, -0.5
        new[:, 0] -= new[:, 0].min()
    row, column = np.full(len(points), -1), np.full(len(points), -1)
    column[numbered], row[numbered] = new[:, 0], new[:, 1]
    return Lattice(row, column, kind, basis, stagger, irregularity)  # type: ignore[arg-type]
