# SPDX-License-Identifier: Apache-2.0
"""A template for a sensor of your own: a flat gel with rounded edges, four LEDs, a grid of dots.

Copy the folder, rename the module and the entry point in pyproject.toml, and replace the figures.
Each default needs a source: where it was measured, who states it, or that it is an assumption.
"""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.cad.parameters import parameter, restated
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.camera_sensor import RectangleSensorParameters

_DRAWING = "our drawing 1207, revision B"


@dataclass(frozen=True)
class MySensorParameters(RectangleSensorParameters):
    """Parameters of my sensor: those of all sensors, and what only this one has."""

    # What only this sensor has: name, bounds, unit, source, meaning.
    edge_mm: float = parameter(
        0.8, minimum=0.2, maximum=1.8, unit="mm", source=f"{_DRAWING}: fillet R 0.8",
        description="radius of the fillet between contact face and wall",
    )  # fmt: skip

    # What all sensors have, with the figures of this one. Unit and meaning are inherited, bounds
    # too unless they are given.
    length_x_mm: float = restated(28.0, source=f"{_DRAWING}: 28 x 22 mm")
    length_y_mm: float = restated(22.0, source=f"{_DRAWING}: 28 x 22 mm")
    corner_radius_mm: float = restated(3.0, minimum=2.1, source=f"{_DRAWING}: corners R 3")
    thickness_mm: float = restated(3.5, minimum=2.5, source=f"{_DRAWING}: 3.5 mm")
    young_modulus_mpa: float = restated(0.25, source="our tensile test of Solaris with Slacker")
    width_px: int = restated(480, source="camera module, cropped and scaled")
    height_px: int = restated(360, source="camera module, cropped and scaled")
    mm_per_px: float = restated(0.05, source="ruler on the gel: 24.0 x 18.0 mm")
    camera_distance_mm: float = restated(26.0, source=_DRAWING)
    window_thickness_mm: float = restated(3.0, source=f"{_DRAWING}: acrylic 3 mm")
    # One value for all LEDs, or one for each: 0 deg is right in the image, 90 deg is down.
    led_angle_deg: float | tuple[float, ...] = restated((0.0, 90.0, 180.0, -90.0), source=_DRAWING)
    led_colors: str | tuple[str, ...] = restated(("red", "green", "blue", "white"), source=_DRAWING)
    led_x_mm: float = restated(13.0, source=_DRAWING)
    led_y_mm: float = restated(10.5, source=_DRAWING)
    led_depth_mm: float = restated(9.0, source=_DRAWING)
    marker_pitch_mm: float = restated(2.0, source="stencil: pitch 2.0 mm")
    marker_area_x_mm: float = restated(20.0, source="stencil: 11 columns")
    marker_area_y_mm: float = restated(14.0, source="stencil: 8 rows")
    marker_radius_mm: float = restated(0.3, source="stencil: holes of 0.6 mm")
    housing_x_mm: float = restated(34.0, source=_DRAWING)
    housing_y_mm: float = restated(28.0, source=_DRAWING)

    def pad(self) -> GelPad:
        """The gel; GelPad refuses dimensions that cannot be built and names the bound."""
        return self.gel_pad(rim="fillet", rim_mm=self.edge_mm)


FAMILY = SensorFamily(
    name="my_sensor",
    title="My sensor: flat gel 28 x 22 x 3.5 mm with rounded edges, 480 x 360 px, dots",
    parameters_type=MySensorParameters,
    references=(_DRAWING,),
)
