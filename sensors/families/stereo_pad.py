# SPDX-License-Identifier: Apache-2.0
"""A flat gel with dots before two cameras that squint: depth by stereo, as GelStereo reads it."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.cad.parameters import restated
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.families.flat_pad import FlatPadParameters

_CHOSEN = "chosen: no figure is taken from a sensor that was built"


@dataclass(frozen=True)
class StereoPadParameters(FlatPadParameters):
    """Parameters of a flat pad with two cameras, white light and dots."""

    camera_x_mm: float | tuple[float, ...] = restated(
        (-4.5, 4.5), source=f"{_CHOSEN}; boards of 8 mm stand side by side"
    )
    camera_tilt_x_deg: float | tuple[float, ...] = restated(
        (12.2, -12.2), source=f"{_CHOSEN}; both axes meet the middle of the gel as it is seen"
    )
    camera_distance_mm: float = restated(24.0, minimum=12, maximum=100, source=_CHOSEN)
    led_count: int = restated(8, zero_means="", source=_CHOSEN)
    led_angle_deg: float | tuple[float, ...] = restated(22.5, source=_CHOSEN)
    led_colors: str | tuple[str, ...] = restated("white", source=f"{_CHOSEN}; dots need no colours")
    marker_pitch_mm: float = restated(1.5, source=f"{_CHOSEN}; a few dots across a fingertip")
    marker_area_x_mm: float = restated(16.0, source=f"{_CHOSEN}; both images show them")
    marker_area_y_mm: float = restated(16.0, source=f"{_CHOSEN}; both images show them")
    marker_radius_mm: float = restated(0.3, source=_CHOSEN)


FAMILY = SensorFamily(
    name="stereo_pad",
    title="Stereo pad: flat gel 25 x 25 x 4 mm with dots, two cameras, 320 x 320 px each",
    parameters_type=StereoPadParameters,
    references=(
        "none: a generic design after the principle of GelStereo (High-Precision 3D Reconstruction "
        "Study with Emphasis on Refractive Calibration of GelStereo-Type Sensors, Sensors 23(5) "
        "2675, 2023)",
    ),
)
