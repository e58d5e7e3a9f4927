# SPDX-License-Identifier: Apache-2.0
"""Random parameters inside all bounds; what contradicts itself is refused by the family."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cad.parameters import Parameter
from sensors import FamilyParameters, SensorFamily
from taccel_lab.errors import InputError

_WIDE = 30.0
"""Ratio of the bounds from which on values are drawn evenly in their logarithm."""


def random_value(spec: Parameter, rng: np.random.Generator) -> Any:
    """A value inside the bounds; one in four is the zero that means something."""
    if spec.choices:
        return str(rng.choice(spec.choices))
    if spec.zero_means and rng.random() < 0.25:
        return 0
    low, high = float(spec.minimum or 0.0), float(spec.maximum or 0.0)
    if low > 0 and high / low > _WIDE:
        value = math.exp(rng.uniform(math.log(low), math.log(high)))
    else:
        value = rng.uniform(low, high)
    value = min(max(value, low), high)
    return round(value) if isinstance(spec.default, int) else value


def random_parameters(
    family: SensorFamily, rng: np.random.Generator
) -> FamilyParameters | InputError:
    """Parameters drawn inside their bounds, or why the family refuses the combination."""
    specs = family.parameters_type.parameters()
    try:
        return family.parameters({name: random_value(spec, rng) for name, spec in specs.items()})
    except InputError as error:
        return error
