# SPDX-License-Identifier: Apache-2.0
"""Ranges of a gel's material about what its profile says, as they were measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from taccel_lab.profile.schema import Provenance
    from taccel_lab.profile.sensor_profile import SensorProfile

_LARGEST_RATIO = 0.4999
"""Poisson's ratio up to which a layer's force is asked for."""
QUANTITIES = ("young_modulus_pa", "poisson_ratio", "friction_coefficient")
"""Quantities of the material block that a profile may state a spread of."""
_MEASURED = ("measured", "calibrated")
"""Kinds of blocks whose spread says something about the sensor."""


@dataclass(frozen=True)
class MeasuredRange:
    """A range about the value of the profile."""

    low: float
    high: float
    rests_on: str
    """Sources of the range, for people."""

    @property
    def sigma(self) -> float:
        """Standard deviation of a quantity that lies in the range with 95 %."""
        return (self.high - self.low) / 4


def measured_ranges(profile: SensorProfile) -> dict[str, MeasuredRange]:
    """Range that holds 95 % of each of ``QUANTITIES`` whose spread the profile states.

    The calibration's 95 % interval, or two standard deviations where it states none, and two
    standard deviations between units (block ``perturbation``), added as what is independent is: the
    half widths by their squares. What was assumed, published or designed has no measured spread.

    Raises:
        InputError: A range that reaches values that no gel has, such as a modulus of 0.
    """
    found = {}
    for name in QUANTITIES:
        known = measured_range(profile, name)
        if known is None:
            continue
        if (
            known.low < 0
            or (name == "young_modulus_pa" and known.low == 0)
            or (name == "poisson_ratio" and known.high >= 0.5)
        ):
            raise InputError(
                f"the spread of {name} that sensor {profile.sensor.name!r} states reaches from "
                f"{known.low:g} to {known.high:g}, which no gel has: give a range of your own"
            )
        found[name] = known
    return found


def measured_range(profile: SensorProfile, name: str) -> MeasuredRange | None:
    """Range of one of ``QUANTITIES``, whether a gel has such values or not; None without a spread
    that was measured."""
    value = float(getattr(profile.material, name))
    widths = [
        part
        for part in (
            _of_fit(profile.material.provenance, name, value),
            _of_units(profile, name),
        )
        if part is not None
    ]
    if not widths:
        return None
    low = value - math.hypot(*(below for below, _, _ in widths))
    high = value + math.hypot(*(above for _, above, _ in widths))
    if name == "friction_coefficient":
        low = max(low, 0.0)
    return MeasuredRange(low, high, " and ".join(what for _, _, what in widths))


def _of_fit(provenance: Provenance, name: str, value: float) -> tuple[float, float, str] | None:
    """Half widths below and above the value by the material's own calibration."""
    if provenance.kind not in _MEASURED:
        return None
    if name in provenance.interval:
        low, high = provenance.interval[name]
        return max(value - low, 0.0), max(high - value, 0.0), "the calibration's 95 % interval"
    if provenance.spread.get(name, 0.0) > 0:
        half = 2 * provenance.spread[name]
        return half, half, "two standard deviations of the calibration"
    return None


def _of_units(profile: SensorProfile, name: str) -> tuple[float, float, str] | None:
    """Half widths by the spread between units."""
    block = profile.perturbation
    if block is None or block.provenance.kind not in _MEASURED:
        return None
    sigma = {
        "young_modulus_pa": block.young_modulus_relative * profile.material.young_modulus_pa,
        "friction_coefficient": block.friction_coefficient,
    }.get(name, 0.0)
    # 0 stands for what was not measured.
    return (2 * sigma, 2 * sigma, "two standard deviations between units") if sigma > 0 else None


def poisson_interval(profile: SensorProfile) -> tuple[float, float] | None:
    """Poisson's ratios of a layer between which 95 % lie; None without a spread that was
    measured."""
    known = measured_range(profile, "poisson_ratio")
    return known and (max(known.low, 0.0), min(known.high, _LARGEST_RATIO))
