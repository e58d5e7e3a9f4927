# SPDX-License-Identifier: Apache-2.0
"""Shore hardness to Young's modulus, with an interval.

A durometer presses an indenter ``2.5 mm * (1 - S / 100)`` deep with a spring whose force rises with
the reading S (ASTM D2240, table of calibrated spring forces):

- type A: 0.550 + 0.075 S newtons, on a truncated cone. Gent (1958), Trans. Inst. Rubber Ind. 34,
  46: E = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S)) MPa.
- type OO: 0.203 + 0.00908 S newtons, on a ball of 1.19 mm radius (3/32 inch across). No formula of
  the literature is in wide use; Hertz's contact of the ball with an incompressible half-space
  gives E = 9 F / (16 sqrt(R) d^1.5).

Both agree where the scales overlap: A 20 is OO 70 in suppliers' tables, 0.73 and 0.67 MPa, and A 30
is OO 80, 1.14 and 1.36 MPa. What readings are not: exact (suppliers keep to +- 5 points), taken
at small strain, or of a material without rate and creep. The interval stands for that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Scale = Literal["00", "A"]

READINGS = {"00": (5.0, 90.0), "A": (3.0, 90.0)}
"""Readings that are converted. Near both ends of a scale a point means ever more."""
FACTOR = 1.7
"""Factor by which the conversions in use differ, and with it the interval on both sides: at A 10
from 0.39 MPa (Qi, Joyce and Boyce 2003, log10 E = 0.0235 S - 0.6403) to 0.67 MPa (the same with a
natural logarithm, as some tables print it)."""
POINTS = 5.0
"""What suppliers' readings are good to; the interval has it in quadrature with ``FACTOR``."""

_TRAVEL_MM = 2.5
_OO_RADIUS_MM = 1.19


@dataclass(frozen=True)
class ShoreModulus:
    """Young's modulus that a reading stands for [Pa]."""

    pa: float
    low_pa: float
    high_pa: float


def modulus_of_shore(scale: Scale, reading: float) -> ShoreModulus:
    """Young's modulus at small strain of a durometer's reading; see the module for the formulas.

    Args:
        scale: ``00`` (the same as OO) or ``A``.
        reading: Within ``READINGS``, which callers check.
    """
    formula = _type_a_mpa if scale == "A" else _type_oo_mpa
    mpa = formula(reading)
    low, high = (
        math.hypot(math.log(FACTOR), math.log(formula(reading + points) / mpa))
        for points in (-POINTS, POINTS)
    )
    return ShoreModulus(1e6 * mpa, 1e6 * mpa * math.exp(-low), 1e6 * mpa * math.exp(high))


def _type_a_mpa(reading: float) -> float:
    return 0.0981 * (56 + 7.62336 * reading) / (0.137505 * (254 - 2.54 * reading))


def _type_oo_mpa(reading: float) -> float:
    force_n = 0.203 + 0.00908 * reading
    depth_mm = _TRAVEL_MM * (1 - reading / 100)
    return 9 * force_n / (16 * math.sqrt(_OO_RADIUS_MM) * depth_mm**1.5)
