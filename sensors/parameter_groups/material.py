# SPDX-License-Identifier: Apache-2.0
"""Young's modulus, Poisson's ratio, density and friction of the gel, and of a skin over it.

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
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.sensors.base import NO_FIGURE, GelMaterial

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
_NO_READING = (
    "none: a reading is converted by Gent's formula (A) or Hertz's ball (00), see docs/sensors.md"
)


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


@dataclass(frozen=True)
class MaterialParameters(ParameterSet):
    """The gel as a solid."""

    parameter_group: ClassVar[str] = "material"

    young_modulus_mpa: float = parameter(
        0.15, minimum=0.005, maximum=5, unit="MPa",
        source="assumption: XP-565 gel as in EstimateModulus (0.15 MPa; earlier versions 0.275 and "
        "0.54). Simulators of GelSight gels use 0.01 to 1 MPa, 55 Shore 00 means about 0.4 by "
        "Gent's formula; forces scale with it, shapes do not",
        description="Young's modulus of the gel at small strain",
    )  # fmt: skip
    shore_00: float = parameter(
        0.0, minimum=READINGS["00"][0], maximum=READINGS["00"][1], unit="Shore 00",
        source=_NO_READING, zero_means="not given",
        description="durometer reading of type OO in place of young_modulus_mpa; the gel is then "
        "incompressible (0.499) unless poisson_ratio is given",
    )  # fmt: skip
    shore_a: float = parameter(
        0.0, minimum=READINGS["A"][0], maximum=READINGS["A"][1], unit="Shore A",
        source=_NO_READING, zero_means="not given",
        description="durometer reading of type A in place of young_modulus_mpa; the gel is then "
        "incompressible (0.499) unless poisson_ratio is given",
    )  # fmt: skip
    poisson_ratio: float = parameter(
        0.46, minimum=0.0, maximum=0.499,
        source="assumption: nearly incompressible silicone; 0.3 to 0.49 are in use",
        description="Poisson's ratio of the gel",
    )  # fmt: skip
    density_kg_m3: float = parameter(
        1000.0, minimum=500, maximum=3000, unit="kg/m3",
        source="Taccel and TacEx defaults; without effect on a quasi-static press",
        description="density of the gel",
    )  # fmt: skip
    friction: float = parameter(
        1.0, minimum=0.0, maximum=5.0,
        source="assumption: FEATS and Taccel use 1.0, gelsight_ansys_sim 0.5",
        description="Coulomb friction coefficient between gel and indenter",
    )  # fmt: skip

    maxwell_modulus: float = parameter(
        0.0, minimum=0.001, maximum=100, source=NO_FIGURE, zero_means="the gel does not relax",
        description="modulus that a sudden strain adds at first, over that of the relaxed gel; a "
        "profile may have three such branches",
    )  # fmt: skip
    maxwell_time_s: float = parameter(
        1.0, minimum=0.001, maximum=1e5, unit="s", source=NO_FIGURE,
        description="time in which that falls to 1/e",
    )  # fmt: skip

    def material(self) -> GelMaterial:
        """The gel's material: a hardness, where one is given, goes before the modulus."""
        pa, interval = self.young_modulus_mpa * 1e6, None
        readings: tuple[tuple[Scale, float], ...] = (("00", self.shore_00), ("A", self.shore_a))
        for scale, reading in readings:
            if reading:
                found = modulus_of_shore(scale, reading)
                pa, interval = found.pa, (found.low_pa, found.high_pa)
        return GelMaterial(
            young_modulus_pa=pa,
            young_interval_pa=interval,
            poisson_ratio=self.poisson_ratio,
            density_kg_m3=self.density_kg_m3,
            friction_coefficient=self.friction,
            branches=((self.maxwell_modulus, self.maxwell_time_s),) if self.maxwell_modulus else (),
        )


@dataclass(frozen=True)
class SkinParameters(ParameterSet):
    """A second solid over the gel; its friction is that of the whole sensor."""

    parameter_group: ClassVar[str] = "material"

    skin_young_modulus_mpa: float = parameter(
        0.3, minimum=0.005, maximum=20, unit="MPa", source=NO_FIGURE, zero_means="that of the gel",
        description="Young's modulus of the skin at small strain",
    )  # fmt: skip
    skin_poisson_ratio: float = parameter(
        0.46, minimum=0.0, maximum=0.499,
        source="assumption: nearly incompressible silicone, as the gel",
        description="Poisson's ratio of the skin",
    )  # fmt: skip
    skin_density_kg_m3: float = parameter(
        1000.0, minimum=500, maximum=3000, unit="kg/m3",
        source="assumption: silicone, as the gel",
        description="density of the skin",
    )  # fmt: skip

    def skin_material(self, gel: GelMaterial) -> GelMaterial:
        """The skin's material on a gel, whose friction is that of the whole sensor."""
        same = not self.skin_young_modulus_mpa
        return replace(
            gel,
            young_modulus_pa=gel.young_modulus_pa if same else self.skin_young_modulus_mpa * 1e6,
            young_interval_pa=gel.young_interval_pa if same else None,
            poisson_ratio=self.skin_poisson_ratio,
            density_kg_m3=self.skin_density_kg_m3,
        )
