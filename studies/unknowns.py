# SPDX-License-Identifier: Apache-2.0
"""What is not known of a gel before it is measured, as factors on the forces of its presses.

Three things, taken as independent of each other:

- what its Shore hardness says of Young's modulus, where that is how the modulus was given;
- what units of one design differ by (``study.unit_spread_percent``);
- Poisson's ratio, where the study leaves it at the catalogue's assumption (a gel of a hardness is
  taken as incompressible): solid silicone may be that, which stiffens a thin layer on a plate. The
  factor is that of the closed form of a bonded layer (``envs.bonded_layer``) at the end of the
  press.

Positions stay and forces scale, exactly for a modulus, at the press's full depth for Poisson's
ratio. Figures at both ends are read from presses scaled by both factors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from taccel_lab.envs import parse_indenter
from taccel_lab.envs.bonded_layer import layer_force_n
from taccel_lab.errors import InputError
from taccel_lab.scene import Ball
from taccel_lab.sensors.base import INCOMPRESSIBLE, FamilyParameters
from taccel_lab.studies.press_record import PressRecord

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

    @property
    def modulus_factors(self) -> tuple[float, float]:
        """Between which the modulus of a unit lies, over that of the design."""
        return math.exp(-self._low), math.exp(self._high)

    def force_factors(self, record: PressRecord) -> tuple[float, float]:
        """Between which the forces of a press lie, over those of the record."""
        return math.exp(-self._low), math.exp(math.hypot(self._high, self._stiffening(record)))

    def _stiffening(self, record: PressRecord) -> float:
        """Logarithm of the force of an incompressible gel over that of this one; 0 where Poisson's
        ratio is given, or for tools without a closed form."""
        kind, _, size = record.indenter.partition(":")
        steps = len(record.depth_mm)
        if self._nu is None or kind not in ("sphere", "cylinder") or not steps:
            return 0.0
        shape = parse_indenter(record.indenter).shape
        radius = shape.radius_m * 1e3 if isinstance(shape, Ball) else float(size)
        depth = record.depth_mm[record.down][-1:]
        try:
            here, there = (
                float(layer_force_n(kind, depth, radius, record.thickness_mm, nu)[0])
                for nu in (self._nu, INCOMPRESSIBLE)
            )
        except InputError:
            return 0.0  # Past the ball's equator, where small strains have ended.
        return max(math.log(there / here), 0.0)
