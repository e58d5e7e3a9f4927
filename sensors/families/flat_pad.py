# SPDX-License-Identifier: Apache-2.0
"""Any flat gel bonded to a plate: the stand-in for sensors that the catalogue does not know.

Self-made sensors are mostly such pads. What a colour calibration takes from the design is the shape
of the gel around a press, in which thickness and Poisson's ratio show a little and the modulus not
at all; ``docs/calibration_color.md`` has the figures. Set the dimensions of your own gel.
"""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.cad.parameters import restated
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.camera_sensor import RectangleSensorParameters

_STAND_IN = "assumption: a stand-in for a sensor that is not in the catalogue; set your own"


@dataclass(frozen=True)
class FlatPadParameters(RectangleSensorParameters):
    """Parameters of a flat pad."""

    length_x_mm: float = restated(25.0, source=_STAND_IN)
    length_y_mm: float = restated(25.0, source=_STAND_IN)
    corner_radius_mm: float = restated(1.5, source=_STAND_IN)
    thickness_mm: float = restated(
        4.0, source=f"{_STAND_IN}. Gels of the catalogue are 2.8 to 5.9 mm thick"
    )
    width_px: int = restated(320, source=_STAND_IN)
    height_px: int = restated(320, source=_STAND_IN)
    mm_per_px: float = restated(0.06, source=_STAND_IN)
    camera_distance_mm: float = restated(24.0, minimum=12, maximum=100, source=_STAND_IN)
    focal_px: float = restated(
        347.7, source="24.0 mm seen through window and gel (20.9 mm) over 0.06 mm/px"
    )
    led_angle_deg: float | tuple[float, ...] = restated(
        (-90.0, 30.0, 150.0),
        source="assumption: one LED of each colour, 120 degrees apart, as in most sensors",
    )
    led_x_mm: float = restated(14.0, source=_STAND_IN)
    led_y_mm: float = restated(14.0, source=_STAND_IN)
    led_size_mm: float = restated(2.0, source=_STAND_IN)
    window_thickness_mm: float = restated(6.0, source=_STAND_IN)
    housing_x_mm: float = restated(34.0, source=_STAND_IN)
    housing_y_mm: float = restated(34.0, source=_STAND_IN)


FAMILY = SensorFamily(
    name="flat_pad",
    title="Any flat bonded pad: a stand-in for sensors that are not in the catalogue",
    parameters_type=FlatPadParameters,
    references=(
        "none: a generic design, after the flat gels of GelSight R1.5, GelSight Wedge and GelSlim",
    ),
)
