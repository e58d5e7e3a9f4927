# SPDX-License-Identifier: Apache-2.0
"""The box that holds window, lights and camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.cad.parts.housing_shape import HousingShape
from taccel_lab.sensors.base import NO_FIGURE


@dataclass(frozen=True)
class HousingParameters(ParameterSet):
    """The box behind the gel that holds window, lights and camera."""

    parameter_group: ClassVar[str] = "housing"

    housing_x_mm: float = parameter(
        30.0, minimum=10, maximum=150, unit="mm", source=NO_FIGURE, description="size along x"
    )
    housing_y_mm: float = parameter(
        30.0, minimum=10, maximum=150, unit="mm", source=NO_FIGURE, description="size along y"
    )
    housing_z_mm: float = parameter(
        30.0, minimum=8, maximum=200, unit="mm", source=NO_FIGURE,
        description="size along z, from its front face backwards",
    )  # fmt: skip
    housing_front_mm: float = parameter(
        5.0, minimum=0.0, maximum=60, unit="mm", source=NO_FIGURE,
        description="distance of the front face behind the apex of the contact face",
    )  # fmt: skip
    housing_wall_mm: float = parameter(
        1.2, minimum=0.4, maximum=3.9, unit="mm",
        source="assumption: a usual wall of printed and moulded housings",
        description="wall thickness",
    )  # fmt: skip
    housing_corner_mm: float = parameter(
        1.0, minimum=0.0, maximum=4.9, unit="mm", source=NO_FIGURE,
        description="radius of the upright edges",
    )  # fmt: skip

    def housing(self, offset_mm: tuple[float, float]) -> HousingShape:
        """The housing about gel xy; the bounds leave room for its walls and corners."""
        return HousingShape(
            size_mm=(self.housing_x_mm, self.housing_y_mm, self.housing_z_mm),
            wall_mm=self.housing_wall_mm,
            corner_radius_mm=self.housing_corner_mm,
            front_z_mm=-self.housing_front_mm,
            offset_mm=offset_mm,
        )
