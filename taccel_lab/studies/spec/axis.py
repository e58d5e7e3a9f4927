# SPDX-License-Identifier: Apache-2.0
"""Swept parameters, values or ranges mapped to [0, 1]; designs of grids and random sweeps."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from taccel_lab.cad.parameters import Parameter
from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import shown
from taccel_lab.studies.spec.study_file import MAX_DESIGNS, ParameterRange

SIGNIFICANT_DIGITS = 9
"""Digits of values that are computed: a design's identity must not depend on the last bit."""


@dataclass(frozen=True)
class Axis:
    """A swept parameter of a family."""

    parameter: Parameter
    values: tuple[Any, ...] | None
    """Listed values, or those of a range with a count; None for a range without."""
    low: float = math.nan
    high: float = math.nan
    """Upper end of a range."""
    log: bool = False
    """Whether values are spread by equal ratios."""
    start: float | None = None

    @property
    def name(self) -> str:
        return self.parameter.name

    @property
    def whole(self) -> bool:
        """Whether values are whole numbers."""
        return isinstance(self.parameter.default, int)

    @property
    def numeric(self) -> bool:
        """Whether values are numbers rather than choices."""
        return not self.parameter.choices

    @property
    def ends(self) -> tuple[float, float]:
        """Least and greatest value of a numeric axis."""
        return (
            (self.low, self.high) if self.values is None else (min(self.values), max(self.values))
        )

    def at(self, unit: float) -> Any:
        """The value at ``unit`` in [0, 1]: of the range, or of the list cut into equal parts."""
        unit = min(max(unit, 0.0), 1.0)
        if self.values is not None:
            return self.values[min(int(unit * len(self.values)), len(self.values) - 1)]
        if self.whole:
            return min(int(self.low + unit * (self.high - self.low + 1)), int(self.high))
        return self._between(unit)

    def _between(self, unit: float) -> float:
        if unit in (0.0, 1.0):
            return float(self.high if unit else self.low)
        if self.log:
            value = self.low * (self.high / self.low) ** unit
        else:
            value = self.low + unit * (self.high - self.low)
        # Bounds with more digits than that stay bounds.
        return min(max(significant(value), self.low), self.high)

    def unit_of(self, value: float) -> float:
        """Where in [0, 1] a value of the range lies; inverse of ``at``."""
        if self.whole:
            return (value + 0.5 - self.low) / (self.high - self.low + 1)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


def significant(value: float) -> float:
    """``value`` rounded to ``SIGNIFICANT_DIGITS``."""
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")


def axis_of(parameter: Parameter, wanted: ParameterRange) -> Axis:
    """The axis that a study file asks for.

    Raises InputError for values outside the family's bounds, of the wrong type, or ranges that
    give fewer whole numbers than asked for.
    """
    if wanted.values is not None:
        values = tuple(parameter.check(value) for value in wanted.values)
        if len(set(values)) < len(values):
            raise InputError(f"{parameter.name}: values repeat themselves: {shown(list(values))}")
        return Axis(parameter, values)
    if parameter.choices:
        raise InputError(
            f"{parameter.name} takes {parameter.allowed()}; give values = [...] and no range"
        )
    low, high = float(wanted.min or 0.0), float(wanted.max or 0.0)
    for end in (wanted.min, wanted.max):
        parameter.check(end)
    minimum = float(parameter.minimum or 0.0)
    if parameter.zero_means and low < minimum:
        raise InputError(
            f"{parameter.name}: 0 means {parameter.zero_means} and is no end of a range; "
            f"give values = [0, ...] or min at least {minimum:g}"
        )
    axis = Axis(parameter, None, low, high, wanted.scale == "log", wanted.start)
    if wanted.count is None:
        return axis
    steps = range(wanted.count)
    units = [step / (wanted.count - 1) for step in steps] if wanted.count > 1 else [0.5]
    values = tuple(axis._between(unit) for unit in units)
    if axis.whole:
        values = tuple(dict.fromkeys(round(value) for value in values))
    if len(values) < wanted.count:
        raise InputError(
            f"{parameter.name} is a whole number: {low:g} to {high:g} gives {len(values)} "
            f"different values, not count = {wanted.count}"
        )
    return Axis(parameter, values, log=wanted.scale == "log")


def grid_points(axes: Sequence[Axis]) -> list[dict[str, Any]]:
    """Every combination of the axes' values, the last axis fastest.

    Raises InputError when there are more than ``MAX_DESIGNS``.
    """
    counts = [len(axis.values or ()) for axis in axes]
    total = math.prod(counts)
    if not 0 < total <= MAX_DESIGNS:
        sizes = " x ".join(map(str, counts))
        raise InputError(
            f"the grid has {sizes} = {total:,} designs; 1 to {MAX_DESIGNS:,} are allowed"
        )
    names = [axis.name for axis in axes]
    return [
        dict(zip(names, values, strict=True))
        for values in itertools.product(*(axis.values or () for axis in axes))
    ]


def random_points(
    axes: Sequence[Axis], count: int, seed: int, sampler: str = "latin-hypercube"
) -> list[dict[str, Any]]:
    """``count`` designs spread evenly over all axes; the same ones for the same seed.

    A Latin hypercube has one design in each of ``count`` slices of every axis. Sobol points fill
    the ranges in sequence, so that a larger count keeps all earlier designs.
    """
    from scipy.stats import qmc

    if sampler == "sobol":
        engine = qmc.Sobol(len(axes), scramble=True, rng=seed)
        with warnings.catch_warnings():
            # Balance properties need a power of two; a study may stop anywhere in the sequence.
            warnings.filterwarnings("ignore", message="The balance properties of Sobol")
            units = engine.random(count)
    else:
        units = qmc.LatinHypercube(len(axes), rng=seed).random(count)
    return [
        {axis.name: axis.at(float(unit)) for axis, unit in zip(axes, row, strict=True)}
        for row in units
    ]
