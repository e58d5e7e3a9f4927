# SPDX-License-Identifier: Apache-2.0
"""Which point of a board is which, among points of which many may be none of it.

The numbering is grown from seeds as for markers
(``taccel_lab.calibration.dots.lattice_growth``). What a board adds is its known number of
columns and rows: the largest lattice of that size is looked for among strangers that may outnumber
it. A smooth polynomial through what was found then predicts the rest of it and rejects strangers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from taccel_lab.calibration.dots.lattice_growth import grow, shortest_basis

_NEAR = 0.3
"""A point is taken for a lattice site within this share of the local pitch."""
_FULL = 0.8
"""Share of the points, or of the sites, that a lattice holds which other seeds need not better."""
_SEEDS = 12
_ROUNDS = 4
_BASES = (
    [[1, 0], [0, 1]],
    [[1, 1], [0, 1]],
    [[1, 0], [1, 1]],
    [[1, -1], [0, 1]],
    [[1, 0], [-1, 1]],
)
"""Changes of basis tried, for views so oblique that a diagonal is the shortest step."""


@dataclass(frozen=True)
class Lattice:
    """Points that lie on a lattice of ``columns`` x ``rows``."""

    points: np.ndarray
    """Which of the given points, int, shape [n]."""
    index: np.ndarray
    """Column and row of each, int, within 0..columns-1 and 0..rows-1, shape [n, 2]."""
    strangers: int
    """Points of the same lattice beyond the window of columns x rows."""
    rms_share: float
    """Distance from the smooth lattice, root mean square, as a share of the pitch."""


def index_lattice(uv_px: np.ndarray, columns: int, rows: int) -> Lattice | None:
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
    for seed in _seeds(uv, tree):
        if best is not None and len(best.points) >= full and seed[0] in set(best.points.tolist()):
            continue  # the seed belongs to the lattice that is known already
        grown = grow(uv, tree, seed[0], seed[1][0], seed[1][1])
        if grown.count < 4 or not grown.spans_the_plane:
            continue
        points = np.flatnonzero(grown.numbered)
        keys = grown.index[points]
        # A seed's steps may be a diagonal and more; the board's sides are the shortest ones, or
        # seen from aslant nearly so.
        change, _ = shortest_basis(keys, uv[points])
        keys = np.rint(keys @ np.linalg.inv(change)).astype(int)
        found = _fit_window(uv, tree, keys, points, columns, rows)
        if found is not None and (best is None or _score(found) > _score(best)):
            best = found
        if best is not None and len(best.points) == columns * rows:
            break
    return best


def _score(lattice: Lattice) -> float:
    return len(lattice.points) - lattice.strangers


def _seeds(uv: np.ndarray, tree: KDTree) -> list[tuple[int, np.ndarray]]:
    """Points with opposite neighbours on two axes, and the axes [2, 2], best first."""
    count = min(9, len(uv))
    distance, near = (np.asarray(found) for found in tree.query(uv, k=count))
    ranked = []
    for i in range(len(uv)):
        steps = uv[near[i, 1:]] - uv[i]
        length = distance[i, 1:]
        if not length[0] > 0:
            continue
        pairs = []
        for a in range(len(steps)):
            for b in range(a + 1, len(steps)):
                gap = np.linalg.norm(steps[a] + steps[b])
                if gap < 0.35 * (length[a] + length[b]) / 2:
                    pairs.append((length[a] + length[b], gap, (steps[a] - steps[b]) / 2))
        pairs.sort(key=lambda pair: pair[0])
        for j in range(1, len(pairs)):
            first, second = pairs[0][2], pairs[j][2]
            area = abs(first[0] * second[1] - first[1] * second[0])
            if area > 0.4 * np.linalg.norm(first) * np.linalg.norm(second):
                regular = (pairs[0][1] + pairs[j][1]) / pairs[0][0]
                ranked.append((regular, i, np.stack([first, second])))
                break
    ranked.sort(key=lambda item: item[0])
    return [(i, axes) for _, i, axes in ranked[: 4 * _SEEDS : max(1, len(ranked) // _SEEDS)]]


def _fit_window(
    uv: np.ndarray,
    tree: KDTree,
    keys: np.ndarray,
    points: np.ndarray,
    columns: int,
    rows: int,
) -> Lattice | None:
    """Fill the grown patch out, in the basis and window that hold the most points."""
    best = None
    for basis in _BASES:
        index = keys @ np.array(basis)
        for wide, high in {(columns, rows), (rows, columns)}:
            inside, low = _window(index, wide, high)
            score = 2 * inside.sum() - len(index)
            if best is None or score > best[0]:
                best = (score, index - low, (wide, high))
    if best is None:
        return None
    _, index, (wide, high) = best
    return _refine(uv, tree, index, points, wide, high, (columns, rows))


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


def _refine(
    uv: np.ndarray,
    tree: KDTree,
    index: np.ndarray,
    points: np.ndarray,
    wide: int,
    high: int,
    asked: tuple[int, int],
) -> Lattice | None:
    """Predict every site from a smooth map, take the points near them, and choose the window."""
    share = np.inf
    for _ in range(_ROUNDS):
        if len(index) < 4 or np.ptp(index[:, 0]) < 1 or np.ptp(index[:, 1]) < 1:
            return None
        low, top = index.min(axis=0), index.max(axis=0)
        grow = np.minimum([wide, high] - (top - low), [wide, high]).clip(1)
        first, last = low - grow, top + grow
        sites = np.stack(
            np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True)),
                        indexing="ij"), axis=-1
        ).reshape(-1, 2)  # fmt: skip
        fitted = _SmoothMap(index, uv[points])
        pitch = fitted.pitch(sites)
        known = _near_known(sites, index)
        distance, nearest = (np.asarray(part) for part in tree.query(fitted(sites)))
        ok = (distance < _NEAR * pitch * np.where(known, 1.0, 0.6)) & known
        order = np.argsort(distance / pitch)
        chosen, seen = [], set()
        for k in order:
            if ok[k] and int(nearest[k]) not in seen:
                seen.add(int(nearest[k]))
                chosen.append(k)
        if len(chosen) < 4:
            return None
        new_index, new_points = sites[chosen], nearest[chosen]
        share = float(np.sqrt(np.mean((distance[chosen] / pitch[chosen]) ** 2)))
        same = len(new_index) == len(index)
        index, points = new_index, new_points
        if same:
            break
    inside, corner = _window(index, wide, high)
    beyond = _whole_lines(index[~inside] - corner, wide, high)
    kept, at = points[inside], index[inside] - corner
    if (wide, high) != asked:
        at = at[:, ::-1]
    return Lattice(kept, at, beyond, share)


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


def _near_known(sites: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Sites within two steps of an indexed one: farther, the map extrapolates too far."""
    distance, _ = KDTree(index).query(sites, p=np.inf)
    return distance <= 2


class _SmoothMap:
    """Robust polynomial from lattice indices to pixels; its degree grows with the data."""

    def __init__(self, index: np.ndarray, uv_px: np.ndarray) -> None:
        self._middle = index.mean(axis=0)
        self._half = np.maximum(np.ptp(index, axis=0) / 2, 1.0)
        least = int(min(len(np.unique(index[:, 0])), len(np.unique(index[:, 1]))))
        self._degree = 3 if len(index) >= 24 and least >= 5 else 2 if len(index) >= 10 and (
            least >= 3) else 1  # fmt: skip
        weights = np.ones(len(index))
        basis = self._basis(index)
        for _ in range(6):
            root = np.sqrt(weights)[:, None]
            self._coefficients, *_ = np.linalg.lstsq(basis * root, uv_px * root, rcond=None)
            away = np.linalg.norm(basis @ self._coefficients - uv_px, axis=1)
            width = 2.0 * np.median(away) + 1e-9
            weights = 1.0 / (1.0 + (away / width) ** 2)

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
