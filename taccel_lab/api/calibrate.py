# SPDX-License-Identifier: Apache-2.0
"""A calibration as a script holds it: its profile presses, reads and renders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import ParamSpec

from taccel_lab.api.sensor import Sensor
from taccel_lab.calibration import calibrate as fitting

Given = ParamSpec("Given")


@dataclass(frozen=True, repr=False, eq=False)
class Calibration(fitting.Calibration):
    """A calibration whose profile has the verbs of the package."""

    profile: Sensor


def _with_verbs(
    fit: Callable[Given, fitting.Calibration],
) -> Callable[Given, Calibration]:
    """The same function, whose result has a ``Sensor``."""

    @wraps(fit)
    def fitted(*given: Given.args, **named: Given.kwargs) -> Calibration:
        found = fit(*given, **named)
        return Calibration(**{**vars(found), "profile": Sensor.of(found.profile)})

    return fitted


calibrate = _with_verbs(fitting.calibrate)
