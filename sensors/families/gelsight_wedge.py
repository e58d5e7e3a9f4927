# SPDX-License-Identifier: Apache-2.0
"""GelSight Wedge: a flat gel on a wedge of acrylic that a camera looks at through a mirror.

The light path is folded by the mirror. It is modelled unfolded: a camera straight behind the gel,
at the length of the path.
"""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.cad.parameters import restated
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.camera_sensor import RectangleSensorParameters

_MODULUS = "EstimateModulus (GelSight-lab)"
_NOT_PUBLISHED = "assumption: no figure of this sensor is published"

_LIGHTS = "assumption: beside the acrylic, as fits to the classic GelSight have it"


@dataclass(frozen=True)
class GelSightWedgeParameters(RectangleSensorParameters):
    """Parameters of a GelSight Wedge."""

    length_x_mm: float = restated(35.0, source=f"{_MODULUS}: 35 x 25.5 mm")
    length_y_mm: float = restated(25.5, source=f"{_MODULUS}: 35 x 25.5 mm")
    corner_radius_mm: float = restated(1.0, source=f"{_NOT_PUBLISHED}; gels are cut with a blade")
    thickness_mm: float = restated(5.5, source=f"{_MODULUS}: 5.5 mm")
    young_modulus_mpa: float = restated(
        0.15,
        source=f"{_MODULUS}: 0.15 MPa (earlier versions 0.275 and 0.54) for XP-565 of Shore "
        "00-58 to 60",
    )
    poisson_ratio: float = restated(0.485, source=f"{_MODULUS}: 0.485")
    width_px: int = restated(390, source="assumption: 33.2 x 23.8 mm, 1 mm inside the gel's edge")
    height_px: int = restated(280, source="assumption: 33.2 x 23.8 mm, 1 mm inside the gel's edge")
    mm_per_px: float = restated(
        0.085, source=f"{_MODULUS}: 11 to 12.5 px/mm after rectification, 0.080 to 0.091"
    )
    camera_distance_mm: float = restated(
        40.0, minimum=15, maximum=120, source=f"{_NOT_PUBLISHED}; path over the mirror, unfolded"
    )
    focal_px: float = restated(
        420.8, source="40 mm seen through window and gel (35.8 mm) over 0.085 mm/px"
    )
    window_thickness_mm: float = restated(
        8.0, source=f"{_NOT_PUBLISHED}; middle of the wedge of acrylic"
    )
    led_angle_deg: float | tuple[float, ...] = restated(
        (0.0, -120.0, 120.0),
        source="assumption: one LED of each colour, 120 degrees apart, as in the classic GelSight",
    )
    led_x_mm: float = restated(18.0, source=_LIGHTS)
    led_y_mm: float = restated(15.6, source=_LIGHTS)
    led_depth_mm: float = restated(9.5, source=_LIGHTS)
    led_tilt_deg: float = restated(90.0, source=_LIGHTS)
    led_size_mm: float = restated(2.0, source=_LIGHTS)
    ambient: float = restated(0.3, source=_LIGHTS)
    housing_x_mm: float = restated(42.0, source=_NOT_PUBLISHED)
    housing_y_mm: float = restated(32.0, source=_NOT_PUBLISHED)
    housing_z_mm: float = restated(42.0, source=f"{_NOT_PUBLISHED}; holds the unfolded path")
    housing_front_mm: float = restated(5.5, source="assumption: level with the back of the gel")


FAMILY = SensorFamily(
    name="gelsight_wedge",
    title="GelSight Wedge: flat gel 35 x 25.5 x 5.5 mm over a mirror, 390 x 280 px",
    parameters_type=GelSightWedgeParameters,
    references=(
        "Wang et al., GelSight Wedge: Measuring High-Resolution 3D Contact Geometry with a Compact "
        "Robot Finger, ICRA 2021",
        "EstimateModulus (GelSight-lab, no licence stated: figures only)",
    ),
)
