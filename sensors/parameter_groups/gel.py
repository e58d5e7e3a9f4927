# SPDX-License-Identifier: Apache-2.0
"""The plan and thickness of a gel on a rounded rectangle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.sensors.parameter_groups.unstated import NO_FIGURE


@dataclass(frozen=True)
class RectangleGelParameters(ParameterSet):
    """A gel whose outline is a rectangle with rounded corners; families add its contact face."""

    parameter_group: ClassVar[str] = "gel"

    length_x_mm: float = parameter(
        24.0, minimum=10, maximum=60, unit="mm", source=NO_FIGURE,
        description="gel size along x (image columns)",
    )  # fmt: skip
    length_y_mm: float = parameter(
        20.0, minimum=10, maximum=60, unit="mm", source=NO_FIGURE,
        description="gel size along y (image rows)",
    )  # fmt: skip
    corner_radius_mm: float = parameter(
        2.0, minimum=0.3, maximum=10, unit="mm", source=NO_FIGURE,
        description="corner radius of the gel's outline",
    )  # fmt: skip
    thickness_mm: float = parameter(
        4.0, minimum=1.5, maximum=12, unit="mm", source=NO_FIGURE,
        description="gel thickness at the apex",
    )  # fmt: skip

    def window_margin_mm(self) -> float:
        """How far inside the outline the corners of the seen rectangle stay, rounding included."""
        # A square corner m inside a rounded one of radius r is r - sqrt(2) (r - m) away from it.
        return max(1.0, 0.3 * self.corner_radius_mm + 0.25)
