# SPDX-License-Identifier: Apache-2.0
"""Growth of a lattice numbering over points, and what the points around a point say about it.

From a point with neighbours on opposite sides the numbering grows outwards. The affine map through
the numbered points around a free one says which site of the lattice it is, as fractions of a step:
near whole numbers it is taken. So perspective, lens distortion and a stretched gel bend the lattice
freely, missing points leave gaps, and stray points find no site.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

_CATCH = 0.27
"""A point is taken for one of the lattice within this share of the shorter step from a site."""
_NEIGHBOURS = 8
"""Numbered points that say which site a point is, and points among which steps are looked for."""
_BELIEF = 0.02
"""Weight of the seed's steps among them: closes what few neighbours leave open."""
_MAX_GAP = 3
"""Steps to the nearest numbered point that the growth can cross."""
_SEEDS = 10
_ENOUGH = 0.9
"""Share of the points that a numbering explains for the search to end."""
_FULL = 0.5
"""Share of neighbouring sites that it fills for that; a lattice through cell centres fills few."""
_SYMMETRIC = 0.25
"""Opposite neighbours are opposite within this share of their distance."""
_MIN_SINE = 0.45
FLIPS = tuple(np.diag(signs) for signs in ((1, 1), (-1, -1), (1, -1), (-1, 1)))
TURNS = (*FLIPS, *(flip[::-1] for flip in FLIPS))
"""Changes of basis that keep rows and columns, and those that also swap them."""


@dataclass(frozen=True)
class Growth:
    """Numbering in the seed's steps."""

    points: np.ndarray
    """Shape [point, 2]."""
    index: np.ndarray
    """Steps from the seed, int, shape [point, 2]; anything where not numbered."""
    numbered: np.ndarray
    """Bool, shape [point]."""
    basis: np.ndarray
    """Both steps at the seed, shape [2, 2]."""

    @property
    def count(self) -> int:
        return int(self.numbered.sum())

    @property
    def spans_the_plane(self) -> bool:
        """Whether the numbered points lie on more than one line."""
        index = self.index[self.numbered]
        return bool(np.linalg.matrix_rank(index - index[:1]) == 2)

    def filled(self) -> float:
        """Share of the sites beside numbered points that are numbered."""
        sites = {tuple(site) for site in self.index[self.numbered].tolist()}
        beside = [(i + di, j + dj) in sites for i, j in sites for di, dj in ((1, 0), (0, 1))]
        return float(np.mean(beside))

    def sites(self, asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What their numbered neighbours, but not themselves, say of some points.

        Args:
            asked: Which points, int, shape [n].

        Returns:
            Their sites, float, shape [n, 2], NaN without a neighbour, and how many steps away the
            nearest neighbour is, shape [n].
        """
        # In the seed's steps, in which the lattice is about square.
        place = self.points @ np.linalg.inv(self.basis)
        known = np.flatnonzero(self.numbered)
        count = min(_NEIGHBOURS + 1, len(known))
        near = np.asarray(KDTree(place[known]).query(place[asked], k=count)[1]).reshape(-1, count)
        near = known[near]
        offset = place[near] - place[asked][:, None]
        weight = np.where(near == asked[:, None], 0.0, 1.0 / (0.25 + (offset**2).sum(axis=2)))
        index = self.index[near].astype(np.float64)
        site, _ = local_affine(offset, index, weight, _BELIEF, np.eye(2))
        steps = np.abs(site[:, None] - index).max(axis=2)
        steps = np.where(weight > 0, steps, np.inf).min(axis=1, initial=np.inf)
        return site, steps

    def errors(self) -> np.ndarray:
        """Error, in shorter steps, of each numbered point against what its neighbours say; NaN
        without."""
        errors = np.full(len(self.points), np.nan)
        which = np.flatnonzero(self.numbered)
        errors[which] = self.length(self.sites(which)[0] - self.index[which])
        return errors

    def length(self, steps: np.ndarray) -> np.ndarray:
        """Length of differences of sites, [n, 2], in shorter steps."""
        length = np.linalg.norm(self.basis, axis=1)
        return np.linalg.norm(steps * length / length.min(), axis=1)


def local_affine(
    offset: np.ndarray,
    values: np.ndarray,
    weight: np.ndarray,
    belief: float,
    slope: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Affine maps through what each point's neighbours have.

    Args:
        offset: Ways from the point to its neighbours, shape [point, neighbour, 2].
        values: What the neighbours have, shape [point, neighbour, 2].
        weight: Of each neighbour, shape [point, neighbour].
        belief: Weight of the believed slope, which closes what few neighbours leave open.
        slope: The believed slope, shape [2, 2]; 0 for constant values.

    Returns:
        Values at the points, shape [point, 2], NaN without a neighbour, and the slopes of the maps,
        shape [point, 2, 2].
    """
    total = weight.sum(axis=1)
    share = (weight / np.where(total > 0, total, np.nan)[:, None])[..., None]
    middle, mean = (share * offset).sum(axis=1), (share * values).sum(axis=1)
    away = offset - middle[:, None]
    weighted = (away * weight[..., None]).transpose(0, 2, 1)
    normal = weighted @ away + belief * np.eye(2)
    right = weighted @ (values - mean[:, None]) + belief * (slope * np.ones((2, 2)))
    found = np.linalg.solve(np.where(np.isfinite(normal), normal, np.eye(2)), right)
    return mean - np.einsum("ni,nij->nj", middle, found), found


def largest_growth(points: np.ndarray) -> Growth | None:
    """The numbering of points [n, 2], among those from several seeds, that explains most of them
    and fills its own sites best; None where no point has neighbours on opposite sides."""
    best, score = None, 0.0
    for seed, basis in _symmetric_seeds(points):
        found = _grow(points, seed, basis)
        # A stray point amid four others seeds a lattice twice as fine, on which those four and the
        # stray lie: more points are explained, but sites beside them are empty.
        filled = found.filled()
        if best is None or found.count * filled > score:
            best, score = found, found.count * filled
        if found.count >= _ENOUGH * len(points) and filled >= _FULL:
            break
    return best


def _grow(points: np.ndarray, seed: int, basis: np.ndarray) -> Growth:
    """All points that a numbering from a seed reaches, those over the smallest gaps first."""
    index, numbered = np.zeros((len(points), 2), dtype=int), np.arange(len(points)) == seed
    growth, gap = Growth(points, index, numbered, basis), 1
    while gap <= _MAX_GAP and not numbered.all():
        free = np.flatnonzero(~numbered)
        site, steps = growth.sites(free)
        whole = np.rint(site)
        miss = growth.length(site - whole)
        sites = {tuple(own) for own in index[numbered].tolist()}
        taken: dict[tuple[int, int], int] = {}
        for n in np.argsort(miss):
            at = int(whole[n, 0]), int(whole[n, 1])
            if miss[n] <= _CATCH / np.sqrt(gap) and steps[n] < gap + 0.5 and at not in sites:
                taken.setdefault(at, int(free[n]))
        which = list(taken.values())
        index[which], numbered[which] = list(taken) or np.zeros((0, 2), dtype=int), True
        gap = 1 if taken else gap + 1
    return growth


def _symmetric_seeds(points: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Points with two pairs of opposite neighbours, the most symmetric first, and their steps."""
    found = []
    near = np.asarray(KDTree(points).query(points, k=min(13, len(points)))[1])
    for n, vectors in enumerate(points[near[:, 1:]] - points[:, None]):
        steps = _steps(vectors)
        if steps is not None:
            found.append((steps[1], n, steps[0]))
    found.sort(key=lambda item: item[0])
    # Spread over the ranks: the most symmetric few may all sit in one odd corner.
    ranks = np.unique(np.linspace(0, len(found) - 1, _SEEDS).astype(int)) if found else ()
    return [found[rank][1:] for rank in ranks]


def _steps(vectors: np.ndarray) -> tuple[np.ndarray, float] | None:
    """The two shortest independent steps that exist in both directions, and their asymmetry."""
    length = np.linalg.norm(vectors, axis=1)
    if not length.all():
        return None
    miss = np.linalg.norm(vectors[:, None] + vectors[None], axis=2)
    other = miss.argmin(axis=1)
    asymmetry = miss.min(axis=1) / length
    steps = 0.5 * (vectors - vectors[other])
    pairs = [k for k in np.argsort(length) if asymmetry[k] <= _SYMMETRIC]
    for k in pairs[1:]:
        sine = abs(np.linalg.det(steps[[pairs[0], k]]))
        if sine > _MIN_SINE * np.prod(np.linalg.norm(steps[[pairs[0], k]], axis=1)):
            return shortest_basis(steps[[pairs[0], k]])[1], float(
                max(asymmetry[pairs[0]], asymmetry[k])
            )
    return None


def shortest_basis(basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two shortest steps of the lattice of a basis, shape [2, 2], by Gauss's reduction.

    Returns:
        The integer change of basis ``change``, and the basis, both of shape [2, 2]; sites by it are
        ``index @ inv(change)``.
    """
    b, change = np.array(basis, dtype=np.float64), np.eye(2, dtype=int)
    for _ in range(20):
        if b[0] @ b[0] > b[1] @ b[1]:
            b, change = b[::-1].copy(), change[::-1].copy()
        k = round(float(b[0] @ b[1] / (b[0] @ b[0])))
        if k == 0:
            break
        b[1] -= k * b[0]
        change[1] -= k * change[0]
    return change, b


def mean_steps(index: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Mean steps along both directions of a numbering, index and points [n, 2], shape [2, 2]."""
    design = np.column_stack([index, np.ones(len(index))])
    return np.linalg.lstsq(design, points, rcond=None)[0][:2]


def turned_to_image(steps: np.ndarray, changes: Sequence[np.ndarray]) -> np.ndarray:
    """The change of basis, integers of shape [2, 2], under which rows run nearest to the
    image's own, to the right, and x to y turns as in the image; ``steps`` as ``mean_steps``."""
    right_handed = [change for change in changes if np.linalg.det(change @ steps) > 0]
    return max(right_handed, key=lambda c: (c[0] @ steps)[0] / np.linalg.norm(c[0] @ steps))


_AROUND = 12
_REACH = 2.6
"""Pitches within which dots are neighbours."""
_STIFF = 0.15
"""Weight of the belief that the field is constant, in neighbours at one pitch."""
_ROUNDS = 3


@dataclass(frozen=True)
class Neighbourhood:
    """Who is next to whom, at rest."""

    rest_px: np.ndarray
    """Shape [marker, 2]."""
    index: np.ndarray
    """Neighbours of each marker, nearest first, int, shape [marker, k]."""
    weight: np.ndarray
    """Falling with distance, 0 beyond the reach, shape [marker, k]."""
    pitch_px: float
    """Median distance of nearest neighbours."""

    @classmethod
    def of(cls, rest_px: np.ndarray) -> Neighbourhood:
        """Neighbours among at least 3 markers."""
        rest_px = np.asarray(rest_px, dtype=np.float64)
        count = min(_AROUND + 1, len(rest_px))
        distance, index = map(np.asarray, KDTree(rest_px).query(rest_px, k=count))
        pitch = float(np.median(distance[:, 1]))
        far = distance[:, 1:] / pitch
        weight = np.where(far <= _REACH, 1.0 / (0.5 + far**2), 0.0)
        # Whoever stands alone still listens to the nearest.
        weight[:, :3] = np.maximum(weight[:, :3], 1e-3)
        return cls(rest_px, index[:, 1:], weight, pitch)

    def extrapolate(
        self, values: np.ndarray, known: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What its known neighbours, but not itself, say of each marker's value.

        Args:
            values: A smooth field such as displacements, shape [marker, 2].
            known: Markers whose value counts, bool, shape [marker].

        Returns:
            Extrapolated values, shape [marker, 2], NaN without a known neighbour; the neighbours'
            scatter about the extrapolation, shape [marker]; sum of their weights, shape [marker].
        """
        around = self.index
        weight = self.weight * known[around]
        value = np.where(known[:, None], values, 0.0)[around]
        offset = (self.rest_px[around] - self.rest_px[:, None]) / self.pitch_px
        total = weight.sum(axis=1)
        robust = weight
        said, scatter = np.full(values.shape, np.nan), np.zeros(len(weight))
        for _ in range(_ROUNDS):
            said, slope = local_affine(offset, value, robust, _STIFF)
            miss = np.linalg.norm(value - said[:, None] - offset @ slope, axis=2)
            squares = np.where(robust > 0, robust * miss**2, 0.0).sum(axis=1)
            scatter = np.sqrt(squares / np.maximum(2 * robust.sum(axis=1), 1e-12))
            bound = np.maximum(scatter, 0.02 * self.pitch_px)[:, None]
            # Cauchy's weights: a dot that was mistaken for another has no say.
            robust = np.where(weight > 0, weight / (1.0 + (miss / bound) ** 2), 0.0)
        return said, scatter, total
