# SPDX-License-Identifier: Apache-2.0
"""The plan and thickness of a gel on a rounded rectangle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import ParameterSet, parameter_of
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.sensors.parameter_groups.unstated import NO_FIGURE


@dataclass(frozen=True)
class RectangleGelParameters(ParameterSet):
    """A gel whose outline is a rectangle with rounded corners; families add its contact face."""

    parameter_group: ClassVar[str] = "gel"

    length_x_mm: float = parameter_of(
        GelPad, "length_x_mm", 24.0, minimum=10, maximum=60, source=NO_FIGURE
    )
    length_y_mm: float = parameter_of(
        GelPad, "length_y_mm", 20.0, minimum=10, maximum=60, source=NO_FIGURE
    )
    corner_radius_mm: float = parameter_of(
        GelPad, "corner_radius_mm", 2.0, maximum=10, source=NO_FIGURE
    )
    thickness_mm: float = parameter_of(
        GelPad, "thickness_mm", 4.0, minimum=1.5, maximum=12, source=NO_FIGURE
    )

    def window_margin_mm(self) -> float:
        """How far inside the outline the corners of the seen rectangle stay, rounding included."""
        # A square corner m inside a rounded one of radius r is r - sqrt(2) (r - m) away from it.
        return max(1.0, 0.3 * self.corner_radius_mm + 0.25)
