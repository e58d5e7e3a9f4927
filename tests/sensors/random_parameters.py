# SPDX-License-Identifier: Apache-2.0
"""Random parameters inside all bounds; what contradicts itself is refused by the family."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from taccel_lab.cad.parameters import Parameter
from taccel_lab.errors import InputError
from taccel_lab.sensors import FamilyParameters, SensorFamily
from taccel_lab.sensors.base import STIFFNESS

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


def value_near_default(spec: Parameter, rng: np.random.Generator, share: float) -> Any:
    """The default changed by up to ``share`` of itself, inside the bounds; choices stay."""
    if spec.choices or (spec.zero_means and spec.default == 0):
        return spec.default
    value = spec.default * (1 + share * rng.uniform(-1, 1))
    value = min(max(value, float(spec.minimum or 0.0)), float(spec.maximum or 0.0))
    return round(value) if isinstance(spec.default, int) else value


def random_parameters(
    family: SensorFamily, rng: np.random.Generator, near: float | None = None
) -> FamilyParameters | InputError:
    """Parameters drawn inside their bounds, or why the family refuses the combination.

    With ``near`` they differ from the defaults by up to that share.
    """
    specs = family.parameters_type.parameters()
    draw = {
        name: random_value(spec, rng) if near is None else value_near_default(spec, rng, near)
        for name, spec in specs.items()
    }
    stiffness = rng.choice(STIFFNESS)
    draw = {name: value for name, value in draw.items() if name not in {*STIFFNESS} - {stiffness}}
    try:
        return family.parameters(draw)
    except InputError as error:
        return error
