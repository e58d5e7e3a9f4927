# SPDX-License-Identifier: Apache-2.0
"""Growth of a lattice numbering over a point set by locally affine extrapolation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, KDTree

_CATCH = 0.27
"""A point is taken for a lattice point within this share of the shorter step from its place."""
_REACH = 2
"""Lattice steps around a place whose points predict it."""
_MAX_GAP = 3
"""Empty places that the growth can cross."""
_SEEDS = 10
_ENOUGH = 0.9
"""Share of the points that a numbering explains for the search to end."""
_FULL = 0.75
"""Share of its own places that it fills for that; a lattice through cell centres fills half."""
_SYMMETRIC = 0.25
"""Opposite neighbours are opposite within this share of their distance."""
_MIN_SINE = 0.45
_NONE = np.iinfo(np.int64).min


def largest_growth(points: np.ndarray) -> Growth | None:
    """Of the numberings from several seeds, [point, 2], the one that explains most points and fills
    its own places best; None where no point has neighbours on opposite sides."""
    best: Growth | None = None
    score, tree = 0.0, KDTree(points)
    for seed, a, b in _symmetric_seeds(points, tree):
        found = _grow(points, tree, seed, a, b)
        # A stray point amid four others seeds a lattice twice as fine, on which those four and the
        # stray lie: more points are explained, but half of the places are empty.
        filled = found.count / _places_within(found)
        if best is None or found.count * filled > score:
            best, score = found, found.count * filled
        if found.count >= _ENOUGH * len(points) and filled >= _FULL:
            break
    return best


def _symmetric_seeds(points: np.ndarray, tree: KDTree) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Points with two pairs of opposite neighbours, the most symmetric first, and their basis."""
    found = []
    near = np.asarray(tree.query(points, k=min(13, len(points)))[1])
    for n in range(len(points)):
        vectors = points[near[n, 1:]] - points[n]
        basis = _basis(vectors)
        if basis is not None:
            a, b, miss = basis
            found.append((miss, n, a, b))
    found.sort(key=lambda item: item[0])
    # Spread over the ranks: the most symmetric few may all sit in one odd corner.
    ranks = np.unique(np.linspace(0, len(found) - 1, _SEEDS).astype(int)) if found else ()
    return [found[rank][1:] for rank in ranks]


def _basis(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
    """The two shortest independent steps that exist in both directions, and their asymmetry."""
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    order = np.argsort(length)
    pairs: list[tuple[np.ndarray, float]] = []
    for k in order:
        if length[k] <= 0:
            return None
        miss = np.hypot(*(vectors + vectors[k]).T)
        other = int(np.argmin(miss))
        if miss[other] > _SYMMETRIC * length[k]:
            continue
        step = 0.5 * (vectors[k] - vectors[other])
        if not pairs:
            pairs.append((step, miss[other] / length[k]))
            continue
        a = pairs[0][0]
        sine = abs(a[0] * step[1] - a[1] * step[0]) / (np.hypot(*a) * np.hypot(*step))
        if sine > _MIN_SINE:
            return a, step, max(pairs[0][1], miss[other] / length[k])
    return None


@dataclass(frozen=True)
class Growth:
    """Numbering in the seed's basis."""

    index: np.ndarray
    """Steps along both basis vectors, int, shape [point, 2]; anything where not numbered."""
    numbered: np.ndarray
    """Bool, shape [point]."""
    a: np.ndarray
    b: np.ndarray
    """Basis at the seed."""

    @property
    def count(self) -> int:
        return int(self.numbered.sum())

    @property
    def spans_the_plane(self) -> bool:
        """Whether the numbered points lie on more than one line."""
        index = self.index[self.numbered]
        return bool(np.linalg.matrix_rank(index - index[:1]) == 2)

    def without(self, which: np.ndarray) -> Growth:
        """The numbering less some points."""
        return Growth(self.index, self.numbered & ~which, self.a, self.b)


class _Field:
    """Numbered points and what they predict."""

    def __init__(self, points: np.ndarray, a: np.ndarray, b: np.ndarray) -> None:
        self.points = points
        self.basis = np.stack([a, b])
        self.at: dict[tuple[int, int], int] = {}

    def predict(
        self, place: tuple[int, int], skip: int = -1
    ) -> tuple[np.ndarray, np.ndarray, int] | None:
        """Place of a lattice point, the local basis, and how many points say so."""
        i, j = place
        rows, targets, weights = [], [], []
        span = range(-_REACH, _REACH + 1)
        for di in span:
            for dj in span:
                n = self.at.get((i + di, j + dj))
                if n is None or n == skip:
                    continue
                rows.append((di, dj))
                targets.append(self.points[n])
                weights.append(1.0 / (0.25 + di * di + dj * dj))
        if not rows:
            return None
        steps, found = np.array(rows, dtype=np.float64), np.array(targets)
        weight = np.array(weights)
        # The seed's basis, as a belief that fades with every point, closes what few points leave
        # open.
        mean_step = weight @ steps / weight.sum()
        mean_point = weight @ found / weight.sum()
        ds, dp = steps - mean_step, found - mean_point
        normal = (ds * weight[:, None]).T @ ds + 0.02 * np.eye(2)
        basis = np.linalg.solve(normal, (ds * weight[:, None]).T @ dp + 0.02 * self.basis)
        return mean_point - mean_step @ basis, basis, len(rows)


def _grow(points: np.ndarray, tree: KDTree, seed: int, a: np.ndarray, b: np.ndarray) -> Growth:
    """Number all points that a lattice through ``seed`` with basis ``a``, ``b`` reaches."""
    field = _Field(points, a, b)
    field.at[(0, 0)] = seed
    taken = np.zeros(len(points), dtype=bool)
    taken[seed] = True
    gap = 1
    tried: dict[tuple[int, int], int] = {}
    while gap <= _MAX_GAP:
        if _sweep(field, tree, taken, gap, tried):
            gap = 1
        else:
            gap += 1
    index = np.full((len(points), 2), _NONE)
    for place, n in field.at.items():
        index[n] = place
    return Growth(index, taken, a, b)


def _sweep(
    field: _Field,
    tree: KDTree,
    taken: np.ndarray,
    gap: int,
    tried: dict[tuple[int, int], int],
) -> bool:
    """Try every empty place next to a numbered one; best supported first. True on progress."""
    steps = [(gap, 0), (-gap, 0), (0, gap), (0, -gap)]
    if gap > 1:
        steps += [(di, dj) for di in (-1, 1) for dj in (-1, 1)]
    places = {(i + di, j + dj) for i, j in field.at for di, dj in steps} - field.at.keys()
    guesses = []
    for place in places:
        guess = field.predict(place)
        if guess is None or tried.get(place) == guess[2]:
            continue
        tried[place] = guess[2]
        guesses.append((guess, place))
    guesses.sort(key=lambda item: -item[0][2])
    progress = False
    for (where, basis, _), place in guesses:
        if place in field.at:
            continue
        shorter = float(np.linalg.norm(basis, axis=1).min())
        distance, n = tree.query(where)
        if distance > _CATCH * shorter / np.sqrt(gap) or taken[n]:
            continue
        field.at[place] = int(n)
        taken[n] = True
        progress = True
    return progress


def _places_within(growth: Growth) -> int:
    """Lattice places, numbered or empty, in the convex hull of the numbered ones."""
    index = growth.index[growth.numbered]
    low, high = index.min(axis=0), index.max(axis=0)
    if not growth.spans_the_plane:
        # One point or a line of them, in which primitive steps count.
        return int(np.gcd(*(high - low))) + 1
    hull = ConvexHull(index.astype(np.float64)).equations
    span = [np.arange(a, b + 1) for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*span, indexing="ij"), axis=-1).reshape(-1, 2)
    return int((places @ hull[:, :2].T + hull[:, 2] <= 1e-6).all(axis=1).sum())


def shortest_basis(index: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two shortest steps of numbered points, by Gauss's reduction of their mean steps.

    Args:
        index: Steps along both basis vectors of a numbering, int, shape [point, 2].
        points: Their places, shape [point, 2].

    Returns:
        The integer change of basis ``change``, and the basis, both of shape [2, 2]; places by the
        basis are ``index @ inv(change)``.
    """
    design = np.column_stack([index.astype(np.float64), np.ones(len(index))])
    b = np.linalg.lstsq(design, points, rcond=None)[0][:2]
    change = np.eye(2, dtype=int)
    for _ in range(20):
        if b[0] @ b[0] > b[1] @ b[1]:
            b, change = b[::-1].copy(), change[::-1].copy()
        k = round(float(b[0] @ b[1] / (b[0] @ b[0])))
        if k == 0:
            break
        b[1] -= k * b[0]
        change[1] -= k * change[0]
    return change, b


def leave_one_out(points: np.ndarray, growth: Growth) -> np.ndarray:
    """Error, in shorter steps, of predicting each numbered point from the others; NaN without."""
    field = _Field(points, growth.a, growth.b)
    numbered = np.flatnonzero(growth.numbered)
    for n in numbered:
        field.at[(int(growth.index[n, 0]), int(growth.index[n, 1]))] = int(n)
    errors = np.full(len(points), np.nan)
    for n in numbered:
        guess = field.predict((int(growth.index[n, 0]), int(growth.index[n, 1])), skip=int(n))
        if guess is not None:
            where, basis, _ = guess
            shorter = float(np.linalg.norm(basis, axis=1).min())
            errors[n] = np.hypot(*(where - points[n])) / max(shorter, 1e-9)
    return errors
