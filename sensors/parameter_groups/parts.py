# SPDX-License-Identifier: Apache-2.0
"""What is built around a gel: housing, window, coating, and the dots painted on its face."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from taccel_lab.cad.parameters import Parameter, ParameterSet, parameter
from taccel_lab.cad.parts.housing_shape import RIM_MM, HousingShape
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import Coating, MarkerGrid
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


@dataclass(frozen=True)
class WindowParameters(ParameterSet):
    """The rigid transparent part behind the gel."""

    parameter_group: ClassVar[str] = "window"

    window_thickness_mm: float = parameter(
        2.0, minimum=0.2, maximum=12, unit="mm", source=NO_FIGURE,
        description="thickness of the window behind the gel",
    )  # fmt: skip
    window_index: float = parameter(
        1.49, minimum=1.0, maximum=2.5,
        source="acrylic (PMMA): 1.49 in visible light",
        description="refractive index of the window",
    )  # fmt: skip
    gel_index: float = parameter(
        1.41, minimum=1.0, maximum=2.5,
        source="clear silicone such as Solaris: about 1.41",
        description="refractive index of the gel",
    )  # fmt: skip
    gel_scattering_per_mm: float = parameter(
        0.0, minimum=0.0, maximum=20, unit="1/mm", source="assumption: a clear gel",
        description="scattering coefficient of a turbid gel (Kubelka and Munk's S)",
    )  # fmt: skip


@dataclass(frozen=True)
class CoatingParameters(ParameterSet):
    """The reflective layer on the gel."""

    parameter_group: ClassVar[str] = "coating"

    coating_albedo: float = parameter(
        0.5, minimum=0.01, maximum=1.0,
        source="assumption: grey pigment; the coating measured for the PBR model of CMURoboTouch's "
        "tactile_optical_simulation reflects 0.40 to 0.51",
        description="diffuse reflectance of the coating",
    )  # fmt: skip
    coating_specular: float = parameter(
        0.0, minimum=0.0, maximum=1.0,
        source="assumption: matte, as the Lambertian coating of tactile_optical_simulation",
        description="weight of the glossy lobe",
    )  # fmt: skip
    coating_roughness: float = parameter(
        0.5, minimum=0.02, maximum=1.0, source="without effect while coating_specular is 0",
        description="width of the glossy lobe (GGX alpha)",
    )  # fmt: skip
    coating_thickness_mm: float = parameter(
        0.02, minimum=0.0, maximum=2.0, unit="mm",
        source="assumption: a sprayed film; no source states it",
        description="thickness of the coating, thin enough to leave out of the mesh",
    )  # fmt: skip

    def coating(self) -> Coating:
        """The coating, the same in all channels."""
        albedo = self.coating_albedo
        return Coating(
            albedo_rgb=(albedo, albedo, albedo),
            specular=self.coating_specular,
            roughness=self.coating_roughness,
            thickness_mm=self.coating_thickness_mm,
        )


@dataclass(frozen=True)
class MarkerParameters(ParameterSet):
    """Dots on the contact face: as many as fit an area and the gel at the pitch, centred."""

    parameter_group: ClassVar[str] = "markers"

    marker_pitch_mm: float = parameter(
        0.0, minimum=0.6, maximum=8, unit="mm", zero_means="no markers",
        source="the sensor has no markers", description="distance of neighbouring dots along x",
    )  # fmt: skip
    marker_pitch_y_mm: float = parameter(
        0.0, minimum=0.6, maximum=8, unit="mm", zero_means="as along x",
        source="assumption: a square grid", description="distance of neighbouring dots along y",
    )  # fmt: skip
    marker_area_x_mm: float = parameter(
        10.0, minimum=0.5, maximum=150, unit="mm", source="without effect while there are no dots",
        description="extent along x within which the centres of the dots lie, if there is gel",
    )  # fmt: skip
    marker_area_y_mm: float = parameter(
        10.0, minimum=0.5, maximum=150, unit="mm", source="without effect while there are no dots",
        description="the same along y",
    )  # fmt: skip
    marker_radius_mm: float = parameter(
        0.35, minimum=0.05, maximum=1.5, unit="mm", source="without effect while there are no dots",
        description="radius of a dot",
    )  # fmt: skip

    def marker_grid(self, on_gel: Callable[[np.ndarray], np.ndarray]) -> MarkerGrid | None:
        """The dots, None without; ``on_gel`` tells of gel xy [mm], [n, 2], whether gel is there.

        Where the area reaches beyond the gel, outer rows and columns are left out until all dots
        lie on it.

        Raises:
            InputError: Dots that overlap, or a gel too small for one.
        """
        if self.marker_pitch_mm == 0:
            return None
        pitch = (self.marker_pitch_mm, self.marker_pitch_y_mm or self.marker_pitch_mm)
        overlap = f"makes dots overlap at a pitch of {min(pitch):g} mm"
        self.require("marker_radius_mm", overlap, high=min(pitch) / 2)
        areas = (self.marker_area_x_mm, self.marker_area_y_mm)
        columns, rows = (
            math.floor(area / step * (1 + 1e-9)) + 1
            for area, step in zip(areas, pitch, strict=True)
        )
        # The four extreme points of each dot, so that all of its paint lies on the gel.
        reach = self.marker_radius_mm * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        while True:
            grid = MarkerGrid(rows, columns, *pitch, self.marker_radius_mm)
            points = grid.points_mm()
            inside = on_gel((points[:, None] + reach).reshape(-1, 2)).reshape(rows, columns, -1)
            if inside.all():
                return grid
            if rows == columns == 1:
                raise InputError(f"no dot of {self.marker_radius_mm:g} mm radius fits the gel")
            # Whichever loses fewer dots per dot outside goes: the outer columns, or the outer rows.
            by_columns = (~inside[:, [0, -1]]).mean() if columns > 1 else -1.0
            by_rows = (~inside[[0, -1]]).mean() if rows > 1 else -1.0
            if by_columns >= by_rows:
                columns -= 1
            else:
                rows -= 1
