# SPDX-License-Identifier: Apache-2.0
"""Which point of a board is which, among points of which many may be none of it.

The numbering is grown from seeds as for markers. What a board adds is its known number of columns
and rows: the largest lattice of that size is looked for among strangers that may outnumber it. A
smooth polynomial through what was found then predicts the rest of it and rejects strangers.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import KDTree

from taccel_lab.calibration.dots.lattice import Lattice
from taccel_lab.calibration.dots.lattice_growth import grow, shortest_basis, symmetric_seeds

_NEAR = 0.3
"""A point is taken for a lattice site within this share of the local pitch."""
_FULL = 0.8
"""Share of the points, or of the sites, that a lattice holds which other seeds need not better."""
_ROUNDS = 4
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
    tree = KDTree(uv)
    full = _FULL * min(len(uv), columns * rows)
    best: Lattice | None = None
    for seed, a, b in symmetric_seeds(uv, tree):
        if best is not None and best.count >= full and best.numbered[seed]:
            continue  # the seed belongs to the lattice that is known already
        grown = grow(uv, tree, seed, a, b)
        if grown.count < 4 or not grown.spans_the_plane:
            continue
        points = np.flatnonzero(grown.numbered)
        keys = grown.index[points]
        # A seed's steps may be a diagonal and more; the board's sides are the shortest ones, or
        # seen from aslant nearly so.
        change, _ = shortest_basis(keys, uv[points])
        keys = np.rint(keys @ np.linalg.inv(change)).astype(int)
        found = _fill_board(uv, tree, keys, points, (columns, rows))
        if found is not None and (best is None or _score(found) > _score(best)):
            best = found
        if best is not None and best.count == columns * rows:
            break
    return best


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


def _score(lattice: Lattice) -> int:
    return lattice.count - lattice.strangers


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


def _fill_board(
    uv: np.ndarray, tree: KDTree, keys: np.ndarray, points: np.ndarray, asked: tuple[int, int]
) -> Lattice | None:
    """Fill a grown patch out, in the basis and window that hold the most points: a smooth map
    predicts every site, the points near them are taken, and the window is chosen again."""
    candidates = []
    for basis in _BASES:
        index = keys @ np.array(basis)
        for size in {asked, asked[::-1]}:
            inside, low = _window(index, *size)
            candidates.append((2 * inside.sum() - len(index), index - low, size))
    _, index, size = max(candidates, key=lambda item: item[0])
    share = np.inf
    for _ in range(_ROUNDS):
        if len(index) < 4 or np.ptp(index[:, 0]) < 1 or np.ptp(index[:, 1]) < 1:
            return None
        low, top = index.min(axis=0), index.max(axis=0)
        beyond = np.minimum(np.array(size) - (top - low), size).clip(1)
        span = [np.arange(a, b + 1) for a, b in zip(low - beyond, top + beyond, strict=True)]
        sites = np.stack(np.meshgrid(*span, indexing="ij"), axis=-1).reshape(-1, 2)
        smooth = _SmoothMap(index, uv[points])
        pitch = smooth.pitch(sites)
        # Farther than two steps from a numbered point the map extrapolates too far.
        known = KDTree(index).query(sites, p=np.inf)[0] <= 2
        distance, nearest = (np.asarray(part) for part in tree.query(smooth(sites)))
        order = np.argsort(distance / pitch)
        order = order[(known & (distance < _NEAR * pitch))[order]]
        # The nearest site has the point.
        chosen = order[np.sort(np.unique(nearest[order], return_index=True)[1])]
        if len(chosen) < 4:
            return None
        settled = len(chosen) == len(index)
        index, points = sites[chosen], nearest[chosen]
        share = float(np.sqrt(np.mean((distance[chosen] / pitch[chosen]) ** 2)))
        if settled:
            break
    inside, corner = _window(index, *size)
    strangers = _whole_lines(index[~inside] - corner, *size)
    kept, at = points[inside], index[inside] - corner
    if size != asked:
        at = at[:, ::-1]
    at = oriented(at, uv[kept], asked[0] == asked[1])
    row, column = np.full(len(uv), -1), np.full(len(uv), -1)
    column[kept], row[kept] = at.T
    return Lattice(row, column, "rectangular", _slopes(at, uv[kept]), 0.0, share, strangers)


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


class _SmoothMap:
    """Robust polynomial from lattice indices to pixels; its degree grows with the data."""

    def __init__(self, index: np.ndarray, uv_px: np.ndarray) -> None:
        self._middle = index.mean(axis=0)
        self._half = np.maximum(np.ptp(index, axis=0) / 2, 1.0)
        least = int(min(len(np.unique(index[:, 0])), len(np.unique(index[:, 1]))))
        self._degree = 3 if len(index) >= 24 and least >= 5 else 2 if len(index) >= 10 and (
            least >= 3) else 1  # fmt: skip
        basis = self._basis(index)
        start = np.linalg.lstsq(basis, uv_px, rcond=None)[0]
        away = np.linalg.norm(basis @ start - uv_px, axis=1)
        slopes = np.kron(basis, np.eye(2))
        self._coefficients = least_squares(
            lambda x: slopes @ x - uv_px.ravel(),
            start.ravel(),
            jac=lambda x: slopes,  # type: ignore[arg-type]
            loss="cauchy",
            f_scale=2.0 * float(np.median(away)) + 1e-9,
        ).x.reshape(-1, 2)

    def _basis(self, index: np.ndarray) -> np.ndarray:
        x, y = ((index - self._middle) / self._half).T
        return np.column_stack(
            [x**i * y**j for i in range(self._degree + 1) for j in range(self._degree + 1 - i)]
        )

    def __call__(self, index: np.ndarray) -> np.ndarray:
        return self._basis(np.asarray(index, dtype=np.float64)) @ self._coefficients

    def pitch(self, index: np.ndarray) -> np.ndarray:
        """Shorter of the two local steps at lattice sites [n, 2], shape [n]."""
        index = np.asarray(index, dtype=np.float64)
        steps = [
            np.linalg.norm(self(index + half) - self(index - half), axis=1)
            for half in ([0.5, 0.0], [0.0, 0.5])
        ]
        return np.maximum(np.minimum(*steps), 1e-6)
