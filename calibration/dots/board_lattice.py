# SPDX-License-Identifier: Apache-2.0
"""Which point of a board is which, among points of which many may be none of it.

The numbering is grown as for markers. What a board adds is its known number of columns and rows:
its points are the fullest window of that size, among strangers that may outnumber them.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.dots.lattice import Lattice
from taccel_lab.calibration.dots.lattice_growth import (
    Growth,
    largest_growth,
    leave_one_out,
    shortest_basis,
)

_BASES = (
    [[1, 0], [0, 1]],
    [[1, 1], [0, 1]],
    [[1, 0], [1, 1]],
    [[1, -1], [0, 1]],
    [[1, 0], [-1, 1]],
)
"""Changes of basis tried, for views so oblique that a diagonal is the shortest step."""


def board_lattice(uv_px: np.ndarray, columns: int, rows: int) -> Lattice | None:
    """The largest lattice of at most ``columns`` x ``rows`` (or turned) among points [n, 2].

    Points may be missing and others be no part of it. None when no seed grows to four points that
    span the plane.
    """
    uv = np.asarray(uv_px, dtype=np.float64)
    if len(uv) < 5:
        return None
    grown = largest_growth(uv)
    if grown is None or grown.count < 4 or not grown.spans_the_plane:
        return None
    return _on_board(uv, grown, (columns, rows))


def oriented(index: np.ndarray, uv_px: np.ndarray, square: bool) -> np.ndarray:
    """Lattice indices [n, 2], from 0, whose x to y turns as in the image, since what looks at the
    front of a board sees it so, and whose columns run to the right as far as they can.

    By flips of the columns and half turns, or quarter turns for a ``square`` board.
    """
    index = np.array(index, dtype=np.int64)
    if np.linalg.det(_slopes(index, uv_px)) < 0:
        index[:, 0] = -index[:, 0]
    along = _slopes(index, uv_px)[0]
    turns = round(float(np.degrees(np.arctan2(along[1], along[0]))) / 90.0) % 4
    if not square and turns % 2:
        turns = 0 if along[0] >= 0 else 2
    for _ in range(turns):
        # A column axis that points down in the image becomes the row axis.
        index = np.column_stack([-index[:, 1], index[:, 0]])
    return index - index.min(axis=0)


def _slopes(index: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
    """Mean steps to the next column and the next row (u, v), shape [2, 2]."""
    design = np.column_stack([index, np.ones(len(index))])
    return np.linalg.lstsq(design, uv_px, rcond=None)[0][:2]


def _window(index: np.ndarray, wide: int, high: int) -> tuple[np.ndarray, np.ndarray]:
    """Points inside the best window of wide x high sites, and its lowest site."""
    low = index.min(axis=0)
    span = index.max(axis=0) - low + 1
    counts = np.zeros(span, dtype=np.int64)
    np.add.at(counts, tuple((index - low).T), 1)
    table = np.pad(counts.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    best, at = -1, (0, 0)
    for i in range(max(1, span[0] - wide + 1)):
        for j in range(max(1, span[1] - high + 1)):
            i1, j1 = min(i + wide, span[0]), min(j + high, span[1])
            total = table[i1, j1] - table[i, j1] - table[i1, j] + table[i, j]
            if total > best:
                best, at = total, (i, j)
    corner = low + np.array(at)
    inside = ((index >= corner) & (index < corner + [wide, high])).all(axis=1)
    return inside, corner


def _on_board(uv: np.ndarray, grown: Growth, asked: tuple[int, int]) -> Lattice:
    """A grown lattice in the basis and window of the board's size that hold the most points."""
    points = np.flatnonzero(grown.numbered)
    keys = grown.index[points]
    # A seed's steps may be a diagonal and more; the board's sides are the shortest ones, or seen
    # from aslant nearly so.
    keys = np.rint(keys @ np.linalg.inv(shortest_basis(keys, uv[points])[0])).astype(int)
    candidates = []
    for basis in _BASES:
        index = keys @ np.array(basis)
        for size in {asked, asked[::-1]}:
            inside, corner = _window(index, *size)
            candidates.append((2 * inside.sum() - len(index), index - corner, size, inside))
    _, index, size, inside = max(candidates, key=lambda item: item[0])
    strangers = _whole_lines(index[~inside], *size)
    kept, at = points[inside], index[inside]
    if size != asked:
        at = at[:, ::-1]
    at = oriented(at, uv[kept], asked[0] == asked[1])
    row, column = np.full(len(uv), -1), np.full(len(uv), -1)
    column[kept], row[kept] = at.T
    errors = leave_one_out(uv, grown)[kept]
    irregularity = float(np.sqrt(np.nanmean(errors**2)))
    return Lattice(row, column, "rectangular", _slopes(at, uv[kept]), 0.0, irregularity, strangers)


def _whole_lines(outside: np.ndarray, wide: int, high: int) -> int:
    """Points in rows or columns beyond the window that are more than half full.

    Single strangers at a lattice site are dirt; a line of them means that the board is larger.
    """
    count = 0
    for axis, length in ((0, high), (1, wide)):
        for line in (-1, (wide, high)[axis]):
            beside = (outside[:, axis] == line) & (outside[:, 1 - axis] >= 0)
            beside &= outside[:, 1 - axis] < length
            if beside.sum() > 0.6 * length:
                count += int(beside.sum())
    return count
