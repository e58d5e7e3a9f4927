# SPDX-License-Identifier: Apache-2.0
"""The classic GelSight (domed gel, 640 x 480 camera) of the Taxim calibration data.

The dome was fitted to the height map ``taxim/calib/gelsight/gelmap.npy`` of the package taxim
1.4.1: heights in pixels times 0.0295 mm. A sphere fits all 307,200 points with radius 50.011 mm,
apex 4.9997 mm, rms 0.0008 mm, greatest residual 0.011 mm; with separate radii they come out as
50.010 and 50.013 mm. The nominal values are therefore 50 mm and 5 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.cad.parameters import parameter, restated
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.camera_sensor import RectangleSensorParameters

_GELMAP = "taxim 1.4.1, calib/gelsight/gelmap.npy"
_TAXIM = "Taxim (Si and Yuan, RA-L 2022), Basics/sensorParams.py and calib/gelsight/params.json"
_LIGHT_FIT = (
    "fit: best of a search against ball presses of Taxim's data (correlation 0.94 to 0.97, "
    "contrast as captured); no drawing is published"
)
_ASSUMED_PLAN = (
    "assumption: no drawing of this gel is published; about 2.5 to 3 mm more than the camera's "
    "view of 18.88 x 14.16 mm on every side"
)


@dataclass(frozen=True)
class GelSightParameters(RectangleSensorParameters):
    """Parameters of a classic GelSight."""

    length_x_mm: float = restated(24.0, source=_ASSUMED_PLAN)
    length_y_mm: float = restated(20.0, source=_ASSUMED_PLAN)
    corner_radius_mm: float = restated(
        2.0, source="assumption: of the order of the 1.5 mm of the GelSight Mini's gel"
    )
    thickness_mm: float = restated(
        5.0,
        maximum=20,
        source=f"{_GELMAP}: apex height 4.9997 mm in a sphere fit; that the map counts from the "
        "glued back is an assumption (GelSight gels are 4 to 5.5 mm thick)",
    )
    crown_radius_mm: float = parameter(
        50.0, minimum=20, maximum=1e5, unit="mm", zero_means="flat",
        source=f"{_GELMAP}: sphere fit 50.011 mm, rms 0.0008 mm",
        description="radius of the spherical contact face",
    )  # fmt: skip
    rim: str = parameter(
        "none", choices=("none", "chamfer", "fillet"),
        source="assumption: the edge lies outside the camera's view",
        description="treatment of the edge of the contact face",
    )  # fmt: skip
    rim_mm: float = restated(0.5, of=GelPad, maximum=2, source="without effect while rim is none")
    width_px: int = restated(640, source=_TAXIM)
    height_px: int = restated(480, source=_TAXIM)
    mm_per_px: float = restated(0.0295, source=f"{_TAXIM}: pixmm")
    focal_px: float = restated(
        658.4, source="24.0 mm, an assumption, seen through window and gel (19.4 mm) over mm_per_px"
    )
    led_angle_deg: float | tuple[float, ...] = restated(
        (-5.0, -116.0, 127.0),
        source="fit: shading of 48 ball presses of Taxim has red -5 +- 7, green -116 +- 8 and "
        "blue 127 +- 8 deg",
    )
    led_x_mm: float = restated(14.0, source=_LIGHT_FIT)
    led_y_mm: float = restated(12.6, source=_LIGHT_FIT)
    led_depth_mm: float = restated(13.0, source=_LIGHT_FIT)
    led_tilt_deg: float = restated(90.0, source=_LIGHT_FIT)
    led_size_mm: float = restated(2.0, source=_LIGHT_FIT)
    ambient: float = restated(0.3, source=_LIGHT_FIT)
    window_thickness_mm: float = restated(
        9.5, source=f"{_LIGHT_FIT}: light as flat as captured comes in at the side of thick acrylic"
    )

    def pad(self) -> GelPad:
        """The gel pad with its spherical crown."""
        radius = self.crown_radius_mm
        return self.gel_pad(crown_radius_x_mm=radius, crown_radius_y_mm=radius)


FAMILY = SensorFamily(
    name="gelsight",
    title="Classic GelSight: domed gel, 640 x 480 px, 18.9 x 14.2 mm view",
    parameters_type=GelSightParameters,
    references=(
        "Si and Yuan, Taxim: An Example-based Simulation Model for GelSight Tactile Sensors, "
        "RA-L 2022 (PyPI package taxim 1.4.1, MIT)",
        "Yuan, Dong and Adelson, GelSight: High-Resolution Robot Tactile Sensors for Estimating "
        "Geometry and Force, Sensors 2017",
    ),
)
