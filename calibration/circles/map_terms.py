# SPDX-License-Identifier: Apache-2.0
"""Terms of the map from a gel's slope, sinking and place in the image to its colour change.

Each term is a product of powers of ``FACTORS``: so is, but for a number, what it changes by with
one of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

FACTORS = ("nx", "ny", "drop", "u", "v")
PLACES = ((0, 0), (1, 0), (0, 1))
"""Powers of u and v: none, or one of both."""
PLAIN = 3
"""Rows before the terms: u, v and 1."""


@dataclass(frozen=True)
class MapTerms:
    """Which terms the map has."""

    degree: int
    """Highest total power of the two slopes."""
    place_degree: int
    """Powers up to this one also depend on the place in the image, linearly."""
    drop_place: bool
    """The sinking's term depends on the place too."""

    @classmethod
    def for_presses(cls, count: int) -> MapTerms:
        """The terms that a number of presses can tell apart."""
        if count < 4:
            return cls(3, 0, False)
        return cls(4, 1, False) if count < 12 else cls(4, 2, True)

    def finer(self) -> MapTerms:
        """One power more of everything: how far circles move then says what the map leaves out."""
        return MapTerms(self.degree + 1, self.place_degree + 1, self.drop_place)

    @property
    def count(self) -> int:
        """Number of terms."""
        return len(self._powers) - PLAIN

    def rows(self, *factors: np.ndarray) -> np.ndarray:
        """u, v, 1 and the terms, shape [3 + count, n]; ``factors`` are ``FACTORS``, shape [n]."""
        rows = np.ones((len(self._powers), len(factors[0])))
        for row, powers in zip(rows, self._powers, strict=True):
            for factor, power in zip(factors, powers, strict=True):
                for _ in range(power):
                    row *= factor
        return rows

    @cached_property
    def rates(self) -> np.ndarray:
        """Change of each row with nx, ny and drop by all rows, shape [3, 3 + count, 3 + count]."""
        rates = np.zeros((3, len(self._powers), len(self._powers)))
        for i, powers in enumerate(self._powers):
            for factor in range(3):
                if powers[factor]:
                    less = tuple(power - (k == factor) for k, power in enumerate(powers))
                    rates[factor, i, self._powers.index(less)] = powers[factor]
        return rates

    def taken_over(self, coefficients: np.ndarray, terms: MapTerms) -> np.ndarray:
        """``coefficients`` [.., terms.count] of other terms, all of which are among these."""
        taken = np.zeros((*coefficients.shape[:-1], self.count))
        taken[..., [self._powers.index(one) - PLAIN for one in terms._terms()]] = coefficients
        return taken

    @cached_property
    def _powers(self) -> list[tuple[int, ...]]:
        """Powers of the factors in each row; lower ones first."""
        return [(0, 0, 0, 1, 0), (0, 0, 0, 0, 1), (0, 0, 0, 0, 0), *self._terms()]

    def _terms(self) -> Iterator[tuple[int, ...]]:
        for total in range(1, self.degree + 1):
            for i in range(total + 1):
                for place in PLACES if total <= self.place_degree else PLACES[:1]:
                    yield (i, total - i, 0, *place)
        for place in PLACES if self.drop_place else PLACES[:1]:
            yield (0, 0, 1, *place)
