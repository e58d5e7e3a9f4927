# SPDX-License-Identifier: Apache-2.0
"""The box that holds window, lights and camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from taccel_lab.cad.parameters import Parameter, ParameterSet, parameter
from taccel_lab.cad.parts.housing_shape import RIM_MM, HousingShape
from taccel_lab.sensors.base import NO_FIGURE


@dataclass(frozen=True)
class HousingParameters(ParameterSet):
    """The box behind the gel that holds window, lights and camera."""

    parameter_group: ClassVar[str] = "housing"

    housing_x_mm: float = parameter(
        30.0,
        minimum=10,
        maximum=150,
        unit="mm",
        source=NO_FIGURE,
        description="size along x; the default grows with what it holds",
    )
    housing_y_mm: float = parameter(
        30.0,
        minimum=10,
        maximum=150,
        unit="mm",
        source=NO_FIGURE,
        description="size along y; the default grows with what it holds",
    )
    housing_z_mm: float = parameter(
        30.0, minimum=8, maximum=200, unit="mm", source=NO_FIGURE,
        description="size along z, from its front face backwards",
    )  # fmt: skip
    housing_front_mm: float = parameter(
        5.0, minimum=0.0, maximum=60, unit="mm", source=NO_FIGURE,
        description="distance of the front face behind the apex of the contact face; the default "
        "gives way to a gel and window that end before it",
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

    def housing(
        self, offset_mm: tuple[float, float], held_mm: np.ndarray, defaults: Mapping[str, Parameter]
    ) -> HousingShape:
        """The housing about gel xy; the bounds leave room for its walls and corners.

        ``held_mm`` are the lowest and highest corner of gel and window [2, 3]. Sizes that nobody
        has stated, the ``defaults``, follow from it.
        """

        def stated(name: str) -> bool:
            return getattr(self, name) != defaults[name].default

        front, seat = self.housing_front_mm, float(-held_mm[0, 2])
        if not stated("housing_front_mm"):
            front = min(front, seat)
        size = []
        for axis, name in enumerate(("housing_x_mm", "housing_y_mm")):
            needed = 2 * float(np.abs(held_mm[:, axis] - offset_mm[axis]).max() + RIM_MM)
            grows = not stated(name) and front < seat - 1e-9
            size.append(max(getattr(self, name), needed) if grows else getattr(self, name))
        return HousingShape(
            size_mm=(size[0], size[1], self.housing_z_mm),
            wall_mm=self.housing_wall_mm,
            corner_radius_mm=self.housing_corner_mm,
            front_z_mm=-front,
            offset_mm=offset_mm,
        )
