# SPDX-License-Identifier: Apache-2.0
"""What is not known of a gel before it is measured, as factors on the forces of its presses.

Four things, taken as independent of each other:

- what its Shore hardness says of Young's modulus, where that is how the modulus was given;
- what units of one design differ by (``study.unit_spread_percent``);
- Poisson's ratio, where the study leaves it at the catalogue's assumption (a gel of a hardness is
  taken as incompressible): solid silicone may be that, which stiffens a thin layer on a plate. The
  factor is that of the closed form of a bonded layer (``envs.bonded_layer``) at the end of the
  press;
- friction, where it is left at the catalogue's assumption, 1.0: a tool that slides lets a thin gel
  flow out from under it. No closed form is known; the factor is a law of balls and flat punches
  that was fitted to presses, see ``_slipping``.

Positions stay and forces scale, exactly for a modulus, at the press's full depth for Poisson's
ratio and friction. Figures at both ends are read from presses scaled by both factors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.presses import parse_indenter
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.scene import Ball
from taccel_lab.sensors.base import INCOMPRESSIBLE, FamilyParameters
from taccel_lab.studies.presses.press_record import PressRecord

_NORMAL_95 = 1.96


class Unknowns:
    """Of one design."""

    def __init__(
        self, parameters: FamilyParameters, given: Mapping[str, Any], unit_spread: float
    ) -> None:
        """``given``: parameters that are not left to the catalogue."""
        layer = parameters.layer_materials()[0]
        pa = layer.young_modulus_pa
        low, high = layer.young_interval_pa or (pa, pa)
        units = _NORMAL_95 * math.log1p(unit_spread)
        self._low = math.hypot(math.log(pa / low), units)
        self._high = math.hypot(math.log(high / pa), units)
        self._nu = None if "poisson_ratio" in given else layer.poisson_ratio
        self._holds = "friction" not in given and layer.friction_coefficient > 0

    def force_factors(self, record: PressRecord) -> tuple[float, float]:
        """Between which the forces of a press lie, over those of the record."""
        low = math.hypot(self._low, self._slipping(record))
        return math.exp(-low), math.exp(math.hypot(self._high, self._stiffening(record)))

    def _slipping(self, record: PressRecord) -> float:
        """Logarithm of the force of this gel over that of one without friction; 0 where friction is
        given, or for tools that no law was fitted to.

        Presses at friction 1 over those without: flat gels of 1, 2 and 3 mm, Poisson's ratio 0.499,
        balls of 2 and 4 mm radius to half of the thickness and a punch of 2 mm to 15 %. The law
        meets logarithms of balls from a tenth of the thickness on within 25 %, of punches within
        5 %. On 9DTacts of 1.5 and 3 mm it gives 0.77 to 1.1 times the logarithm of balls, and up to
        0.13 too much of a punch. At a lower Poisson's ratio it is less.
        """
        found = _round_tool(record)
        if not self._holds or found is None:
            return 0.0
        kind, radius, depth = found
        if kind == "cylinder":
            return 0.21 * (radius / record.thickness_mm) ** 1.17
        return 0.63 * (depth / record.thickness_mm) ** 1.16 * (radius / record.thickness_mm) ** 0.43

    def _stiffening(self, record: PressRecord) -> float:
        """Logarithm of the force of an incompressible gel over that of this one; 0 where Poisson's
        ratio is given, or for tools without a closed form."""
        found = _round_tool(record)
        if self._nu is None or found is None:
            return 0.0
        kind, radius, depth = found
        try:
            here, there = (
                float(layer_force_n(kind, np.array([depth]), radius, record.thickness_mm, nu)[0])
                for nu in (self._nu, INCOMPRESSIBLE)
            )
        except InputError:
            return 0.0  # Past the ball's equator, where small strains have ended.
        return max(math.log(there / here), 0.0)


def _round_tool(record: PressRecord) -> tuple[Literal["sphere", "cylinder"], float, float] | None:
    """Kind and radius [mm] of a ball or flat punch, and how deep the press goes [mm]; None for
    other tools and for presses without a step."""
    kind, _, size = record.indenter.partition(":")
    if kind not in ("sphere", "cylinder") or not len(record.depth_mm):
        return None
    shape = parse_indenter(record.indenter).shape
    radius = shape.radius_m * 1e3 if isinstance(shape, Ball) else float(size)
    return kind, radius, float(record.depth_mm[record.down][-1])
