# SPDX-License-Identifier: Apache-2.0
"""GelSight R1.5, a flat gel on a robot finger, as TacSL models it; no longer sold."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.cad.parameters import restated
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.camera_sensor import RectangleSensorParameters

_TACSL = "TacSL, tacsl_gelsight_r15.yaml"
_NOT_PUBLISHED = "assumption: no drawing of this sensor is published"

_LIGHT_FIT = (
    "fit to the background of one unit (correlation 0.60 to 0.89); no press of known shape and no "
    "drawing is published"
)


@dataclass(frozen=True)
class GelSightR15Parameters(RectangleSensorParameters):
    """Parameters of a GelSight R1.5."""

    length_x_mm: float = restated(23.977, source=f"{_TACSL}: elastomer 23.977 x 32 mm")
    length_y_mm: float = restated(32.0, source=f"{_TACSL}: elastomer 23.977 x 32 mm")
    corner_radius_mm: float = restated(1.5, source=f"{_NOT_PUBLISHED}; as the GelSight Mini's")
    thickness_mm: float = restated(
        4.0, source=f"{_NOT_PUBLISHED}; GelSight gels are 4 to 5.5 mm thick"
    )
    width_px: int = restated(240, source=f"{_TACSL}: 240 x 320 px")
    height_px: int = restated(320, source=f"{_TACSL}: 240 x 320 px")
    mm_per_px: float = restated(0.0877, source=f"{_TACSL}: 21.0 x 28.1 mm")
    camera_distance_mm: float = restated(
        20.343, minimum=12, maximum=80, source=f"{_TACSL}: camera_dist 20.343 mm"
    )
    focal_px: float = restated(
        183.1, source="20.343 mm seen through window and gel (16.1 mm) over 0.0877 mm/px"
    )
    led_angle_deg: float | tuple[float, ...] = restated(
        (0.0, -120.0, 120.0),
        source="assumption: one LED of each colour, 120 degrees apart, as in the classic GelSight",
    )
    led_x_mm: float = restated(12.5, source=_LIGHT_FIT)
    led_y_mm: float = restated(16.5, source=_LIGHT_FIT)
    led_depth_mm: float = restated(12.0, source=_LIGHT_FIT)
    led_tilt_deg: float = restated(90.0, source=_LIGHT_FIT)
    led_size_mm: float = restated(2.0, source=_LIGHT_FIT)
    ambient: float = restated(0.5, source=_LIGHT_FIT)
    window_thickness_mm: float = restated(9.5, source="assumption: as the classic GelSight's")
    housing_x_mm: float = restated(30.0, source=_NOT_PUBLISHED)
    housing_y_mm: float = restated(38.0, source=_NOT_PUBLISHED)


FAMILY = SensorFamily(
    name="gelsight_r15",
    title="GelSight R1.5: flat gel 24.0 x 32 mm, 240 x 320 px (as in TacSL)",
    parameters_type=GelSightR15Parameters,
    references=(
        "Akinola et al., TacSL: A Library for Visuotactile Sensor Simulation and Learning, 2024 "
        "(IsaacGymEnvs, BSD-3; IsaacLab)",
    ),
)
