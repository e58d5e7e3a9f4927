# SPDX-License-Identifier: Apache-2.0
"""What the colours of a press depend on: the slope of a gel under a ball, and the map to colours.

Inside the contact the gel has the ball's shape: ``n(r) = r / R``, n being the horizontal part of
the unit normal. Outside it sinks like Hertz's half-space (K. L. Johnson, Contact Mechanics, 1985,
eq. 3.42a, differentiated):

    slope(r) / slope(a) = 2/pi (x asin(1/x) - sqrt(1 - 1/x^2)),   x = r / a,

damped by ``exp(-(r - a) / l)``: a gel bonded to a plate, and all the more one pressed deeply, sinks
over a shorter distance. ``l = sqrt(R^2 - a^2)`` follows our own finite-element presses (bonded pad
of 2.5 R thickness, contact radii of 0.52, 0.74 and 0.91 R) to 0.01 to 0.03 in n out to 2.5 a, where
the half-space is off by 0.04 to 0.22. It is taken a quarter longer (``SINK_IN_SCALE``): colours of
presses on three sensors all ask for more, up to twice as much.

Each term of the map is a product of powers of ``FACTORS``: so is, but for a number, what it changes
by with one of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter1d

MAX_CONTACT_RATIO = 0.97
"""Largest contact radius that the law takes, in ball radii: at 1 the ball's slope is infinite."""
LARGEST_RATIO = 0.995
WIDER_PX = 0.2
"""Finite difference over the contact's radius, up to ``LARGEST_RATIO`` ball radii."""
SINK_IN_SCALE = 1.25
"""Damping length over ``sqrt(R^2 - a^2)``."""
TABLE_STEPS = 280
FACTORS = ("nx", "ny", "drop", "u", "v")
PLACES = ((0, 0), (1, 0), (0, 1))
"""Powers of u and v: none, or one of both."""
PLAIN = 3
"""Rows before the terms: u, v and 1."""


def hertz_slope(ratio: np.ndarray) -> np.ndarray:
    """Slope of Hertz's half-space outside the contact over that at its rim; ``ratio`` = r/a >= 1"""
    ratio = np.maximum(ratio, 1.0)
    return (2 / np.pi) * (ratio * np.arcsin(1 / ratio) - np.sqrt(1 - 1 / ratio**2))


def slope_law(
    distance_px: np.ndarray,
    contact_px: float,
    ball_px: float,
    blur_px: float,
    reach_px: float,
    sink_in: float = SINK_IN_SCALE,
) -> np.ndarray:
    """Horizontal part of the unit normal, 0..1, and how far the gel has sunk, in ball radii, at
    distances from the press's centre; and how both change with the distance, with the contact's
    radius and with the blur, shape [4, 2, n] of [n].

    Args:
        distance_px: Where the law is read, up to ``reach_px``.
        contact_px: Radius of the contact.
        ball_px: Radius of the ball.
        blur_px: Standard deviation of what blurs the picture.
        reach_px: How far out it is tabulated.
        sink_in: Damping length over ``sqrt(R^2 - a^2)``.
    """
    contact = np.array([[min(contact_px, MAX_CONTACT_RATIO * ball_px)]])
    contact = np.minimum(contact + [[0.0], [WIDER_PX]], LARGEST_RATIO * ball_px)
    beside = np.sqrt(ball_px**2 - contact**2)
    away = np.linspace(0.0, reach_px, TABLE_STEPS)
    inside = np.minimum(away, contact)
    past = np.maximum(away - contact, 0.0)
    slope = inside / np.sqrt(ball_px**2 - inside**2)
    slope *= hertz_slope(away / contact) * np.exp(-past / (sink_in * beside))
    step = away[1]
    sunk = np.cumsum(slope[:, ::-1], axis=1)[:, ::-1] * (step / ball_px)
    tables = np.stack([slope / np.sqrt(1 + slope**2), sunk], axis=1)
    if blur_px > 0.05 * step:
        tables = _blur(tables, blur_px / step)
    both, wider = tables
    by_distance = np.gradient(both, step, axis=1)
    # A Gaussian spreads as heat does: its width's rate is its width times the curvature.
    by_blur = blur_px * np.gradient(by_distance, step, axis=1)
    tables = np.concatenate([both, by_distance, (wider - both) / WIDER_PX, by_blur])
    position = np.minimum(distance_px / step, TABLE_STEPS - 1.001)
    low = position.astype(np.intp)
    rises = np.diff(tables, axis=1)
    values = np.take(tables, low, axis=1) + np.take(rises, low, axis=1) * (position - low)
    return values.reshape(4, 2, *distance_px.shape)


def _blur(both: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian along a ray that goes on through the centre to the other side, where the normal,
    the first of both, leans the other way; shape [.., 2, n]."""
    reach = min(both.shape[-1] - 1, int(4 * sigma) + 2)
    other = both[..., reach:0:-1] * np.array([[-1.0], [1.0]])
    whole = np.concatenate([other, both], axis=-1)
    return gaussian_filter1d(whole, sigma, mode="nearest")[..., reach:]


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
        for row, before, factor in self._products:
            np.multiply(rows[before], factors[factor], out=rows[row])
        return rows

    @cached_property
    def _products(self) -> list[tuple[int, int, int]]:
        """Each row that is not 1, the earlier one that it is a multiple of, and the factor."""
        found = []
        for row, powers in enumerate(self._powers):
            if any(powers):
                last = max(k for k, power in enumerate(powers) if power)
                less = tuple(power - (k == last) for k, power in enumerate(powers))
                found.append((row, self._powers.index(less), last))
        return found

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
