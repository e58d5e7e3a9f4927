# SPDX-License-Identifier: Apache-2.0
"""The custom GelSight of Taccel: a square pad of 40 mm with bevelled edges, stuck to its sides."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.cad.parameters import parameter, restated
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import MIN_WALL_MM
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.camera_sensor import RectangleSensorParameters

_PAD = "measured on the pad of Taccel's single_sensor (Taccel-Simulator/Taccel)"
_TACCEL = "VBTSConfig and render.yml of Taccel"
_NOT_MODELLED = "assumption: Taccel models no housing"

_LIGHTS = "assumption: beside the acrylic, as fits to the classic GelSight have it"


@dataclass(frozen=True)
class GelSight40Parameters(RectangleSensorParameters):
    """Parameters of the square GelSight."""

    length_x_mm: float = restated(40.0, minimum=16, maximum=80, source=f"{_PAD}: 40 x 40 mm")
    length_y_mm: float = restated(40.0, minimum=16, maximum=80, source=f"{_PAD}: 40 x 40 mm")
    corner_radius_mm: float = restated(
        0.3, maximum=8, source=f"{_PAD}: sharp corners; rounded as little as the mesh allows"
    )
    thickness_mm: float = restated(
        5.925, minimum=3, maximum=15,
        source=f"{_PAD}: 5.925 mm. The box pad.stl beside it is 3.0 mm thick, the mesh that Taccel "
        "simulates is not",
    )  # fmt: skip
    bevel_mm: float = parameter(
        3.05, minimum=0.4, maximum=6, unit="mm", source=f"{_PAD}: top face 33.9 x 33.9 mm",
        description="width of the bevel in plan",
    )  # fmt: skip
    bevel_height_mm: float = parameter(
        2.954, minimum=0.4, maximum=6, unit="mm", source=f"{_PAD}: walls upright for 2.971 mm",
        description="height of the bevel",
    )  # fmt: skip
    young_modulus_mpa: float = restated(0.5, source=f"{_TACCEL}: 0.5 MPa")
    poisson_ratio: float = restated(0.4, source=f"{_TACCEL}: 0.4")
    friction: float = restated(1.0, source=f"{_TACCEL}: 1.0")
    width_px: int = restated(400, source=f"{_TACCEL}: 400 x 400 px")
    height_px: int = restated(400, source=f"{_TACCEL}: 400 x 400 px")
    mm_per_px: float = restated(0.079375, source=f"{_TACCEL}: cam_pixel_size, 31.75 mm")
    raw_width_px: int = restated(400, source=f"{_TACCEL}: no crop")
    raw_height_px: int = restated(400, source=f"{_TACCEL}: no crop")
    camera_distance_mm: float = restated(
        31.9, minimum=15, maximum=120,
        source="what a view of 31.75 mm and cam_fov 60 deg need through window and gel; render.yml "
        "of Taccel has the eye at 24.5 mm, where 60 deg show less",
    )  # fmt: skip
    focal_px: float = restated(346.4, source=f"{_TACCEL}: cam_fov 60 deg over 400 px")
    led_angle_deg: float | tuple[float, ...] = restated(
        (0.0, -120.0, 120.0),
        source="assumption: one LED of each colour, 120 degrees apart, as in the classic GelSight",
    )
    led_x_mm: float = restated(20.5, source=_LIGHTS)
    led_y_mm: float = restated(23.7, source=_LIGHTS)
    led_depth_mm: float = restated(10.0, source=_LIGHTS)
    led_tilt_deg: float = restated(90.0, source=_LIGHTS)
    led_size_mm: float = restated(2.0, source=_LIGHTS)
    ambient: float = restated(0.3, source=_LIGHTS)
    window_thickness_mm: float = restated(8.0, source=_LIGHTS)
    marker_pitch_mm: float = restated(3.8, source=f"{_PAD}: 8 x 8 markers, pitch 3.8 mm")
    marker_area_x_mm: float = restated(26.6, source=f"{_PAD}: markers at +-13.3 mm")
    marker_area_y_mm: float = restated(26.6, source=f"{_PAD}: markers at +-13.3 mm")
    marker_radius_mm: float = restated(0.5, source="assumption: Taccel tracks points")
    housing_x_mm: float = restated(44.0, source=_NOT_MODELLED)
    housing_y_mm: float = restated(44.0, source=_NOT_MODELLED)
    housing_z_mm: float = restated(32.0, source=_NOT_MODELLED)
    housing_front_mm: float = restated(
        2.9, source=f"{_PAD}: stuck from 2.9 mm below the face, where a frame would end"
    )

    def pad(self) -> GelPad:
        """The bevelled pad, its walls stuck to the frame."""
        wall = f"leaves no wall under a gel of thickness_mm = {self.thickness_mm:g}"
        self.require("bevel_height_mm", wall, high=self.thickness_mm - MIN_WALL_MM)
        return self.gel_pad(
            rim="chamfer",
            rim_mm=self.bevel_mm,
            wall_mm=self.thickness_mm - self.bevel_height_mm,
            bond_sides="yes",
        )


FAMILY = SensorFamily(
    name="gelsight_40",
    title="GelSight 40 x 40: Taccel's square pad 40 x 40 x 5.925 mm, bevelled, 8 x 8 markers",
    parameters_type=GelSight40Parameters,
    references=(
        "Li et al., Taccel: Scaling Up Vision-based Tactile Robotics via High-performance GPU "
        "Simulation, NeurIPS 2025 (Taccel-Simulator/Taccel, MIT wording)",
    ),
)
