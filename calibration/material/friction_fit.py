# SPDX-License-Identifier: Apache-2.0
"""The coefficient of friction of a fit whose parameter is its logarithm."""

from __future__ import annotations

import math
from typing import Protocol

from taccel_lab.calibration.material.likelihood import Solution
from taccel_lab.calibration.result import NORMAL_95


class _Fit(Protocol):
    @property
    def solution(self) -> Solution: ...

    @property
    def table_error(self) -> float: ...


class FrictionFit:
    """What fits with a parameter ``ln_mu`` say of friction; they give ``solution`` and
    ``table_error``, the relative error of the simulated table."""

    @property
    def friction(self: _Fit) -> float:
        """The coefficient."""
        return math.exp(self.solution.value("ln_mu"))

    @property
    def friction_interval(self: _Fit) -> tuple[float, float]:
        """95 % interval: the profile's, widened by the error of the table."""
        value = self.solution.value("ln_mu")
        low, high = self.solution.profiles["ln_mu"].interval
        model = NORMAL_95 * self.table_error
        return (
            math.exp(value - math.hypot(value - low, model)),
            math.exp(value + math.hypot(high - value, model)),
        )

    @property
    def relative_sigma(self: _Fit) -> float:
        """Standard deviation of the coefficient as a part of it, the table included."""
        return math.hypot(self.solution.sigma_of("ln_mu"), self.table_error)

    @property
    def friction_told(self: _Fit) -> bool:
        """Whether the record ends the coefficient's interval on both sides."""
        profile = self.solution.profiles["ln_mu"]
        return not (profile.open_low or profile.open_high)
