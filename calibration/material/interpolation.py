# SPDX-License-Identifier: Apache-2.0
"""Smooth functions of two parameters of the gel and of a way of the tool, through simulated values.

Over the parameters they are Chebyshev polynomials through the values at the nodes, along the way
(the depth) cubic splines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.interpolate import CubicSpline


@dataclass(frozen=True)
class ParameterAxis:
    """A parameter between two ends, and the function of it in which responses are smooth."""

    low: float
    high: float
    """The same where the parameter is held."""
    smooth_in: Literal["itself", "compressibility"] = "itself"
    """``compressibility``: sqrt(1 - 2 nu) of Poisson's ratio, in which forces are nearly
    polynomial up to incompressibility."""

    @property
    def held(self) -> bool:
        return self.low == self.high

    def nodes(self, count: int) -> np.ndarray:
        """Values at the Chebyshev nodes; one where the parameter is held."""
        if self.held:
            return np.array([self.low])
        least, most = self._ends()
        s = 0.5 * (most + least) + 0.5 * (most - least) * (2 * chebyshev_nodes(count) - 1)
        return s if self.smooth_in == "itself" else 0.5 * (1 - s**2)

    def place(self, value: float) -> tuple[float, float]:
        """z in -1..1 of the smooth function at a value, and dz by the value."""
        if self.held:
            return 0.0, 0.0
        least, most = self._ends()
        s, slope = self._smooth(value)
        return (2 * s - most - least) / (most - least), 2 * slope / (most - least)

    def _ends(self) -> tuple[float, float]:
        """Least and largest value of the smooth function."""
        low, high = self._smooth(self.low)[0], self._smooth(self.high)[0]
        return min(low, high), max(low, high)

    def _smooth(self, value: float) -> tuple[float, float]:
        """The smooth function, and its derivative."""
        if self.smooth_in == "itself":
            return value, 1.0
        s = math.sqrt(1 - 2 * value)
        return s, -1 / s


class ForceResponse(NamedTuple):
    """Values of a table, [..., item, point], and their derivatives."""

    value: np.ndarray
    by_first: np.ndarray
    by_second: np.ndarray
    by_travel: np.ndarray


@dataclass(frozen=True)
class ResponseTable:
    """Interpolated responses of a simulated gel."""

    first: ParameterAxis
    second: ParameterAxis
    travel: np.ndarray
    """Rising, shape [knot]."""
    coefficients: np.ndarray
    """Of Chebyshev polynomials, shape [first, second, ..., knot]."""

    @classmethod
    def through(
        cls, first: ParameterAxis, second: ParameterAxis, travel: np.ndarray, values: np.ndarray
    ) -> ResponseTable:
        """The table through values at the nodes, shape [first, second, ..., knot]."""
        one, two = (
            np.linalg.inv(chebvander([axis.place(v)[0] for v in axis.nodes(count)], count - 1))
            for axis, count in zip((first, second), values.shape[:2], strict=True)
        )
        return cls(first, second, travel, np.einsum("im,jn,mn...->ij...", one, two, values))

    def __post_init__(self) -> None:
        spline = CubicSpline(self.travel, self.coefficients, axis=-1)
        object.__setattr__(self, "_spline", spline)
        object.__setattr__(self, "_slope", spline.derivative())

    def at(self, first: float, second: float, travel: np.ndarray) -> ForceResponse:
        """Responses and derivatives, shape [..., point]; past the ends of the way those there."""
        x = np.clip(travel, self.travel[0], self.travel[-1])
        c = self._spline(x)  # type: ignore[attr-defined]
        along = self._slope(x)  # type: ignore[attr-defined]
        along[..., x != travel] = 0.0
        rows, columns, *shape = c.shape
        z, by_first = self.first.place(first)
        one, one_slope = chebyshev_basis(z, rows)
        z, by_second = self.second.place(second)
        two, two_slope = chebyshev_basis(z, columns)
        terms = np.array([np.outer(one, two), np.outer(by_first * one_slope, two),
                          np.outer(one, by_second * two_slope)])  # fmt: skip
        terms = terms.reshape(3, -1)
        found = (terms @ c.reshape(rows * columns, -1)).reshape(3, *shape)
        by_travel = (terms[0] @ along.reshape(rows * columns, -1)).reshape(shape)
        return ForceResponse(found[0], found[1], found[2], by_travel)


def chebyshev_nodes(count: int) -> np.ndarray:
    """Chebyshev nodes in 0..1, falling."""
    return 0.5 * (1 + np.cos(math.pi * (np.arange(count) + 0.5) / count))


def chebyshev_basis(z: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """T_0 .. T_{count-1} at z and their derivatives."""
    # T_k = cos(k a) and T_k' = k sin(k a) / sin(a), by their recurrences: quicker than numpy's.
    value, slope = [1.0, z], [0.0, 1.0]
    for _ in range(2, count):
        value.append(2 * z * value[-1] - value[-2])
        slope.append(2 * value[-2] + 2 * z * slope[-1] - slope[-2])
    return np.array(value[:count]), np.array(slope[:count])
