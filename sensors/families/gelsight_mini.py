# SPDX-License-Identifier: Apache-2.0
"""GelSight Mini: a crowned pad whose edge is one wide arc, in a case of 32 x 28 mm.

The pad's shape was measured on the STEP file of the gel that FEATS publishes: plan 25.25 x 20.75
mm, vertical walls of 2.75 mm, a rim about 3 mm wide, apex 4.00 mm above the flange of the cap. The
case was measured on the STEP file of the shell in gsrobotics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import parameter, restated
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.errors import InputError
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.camera_sensor import RectangleSensorParameters

_GEL = "measured on gelsight_mini.step of FEATS (feats-ai/feats, MIT)"
_FIT = (
    f"{_GEL}: fit of the closed form, greatest error 0.007 mm on both mid-sections, 0.08 mm over "
    "the whole face"
)
_LIGHT_FIT = (
    "fit: best of a search against four ball presses of another unit (correlation 0.94 to 0.96, "
    "contrast 0.97 of the captured); no drawing is published"
)
_CASE = "measured on gsmini_shell of gsrobotics (gelsightinc/gsrobotics)"
_ANSYS = "gelsight_ansys_sim (irisxu02)"


@dataclass(frozen=True)
class GelSightMiniParameters(RectangleSensorParameters):
    """Parameters of a GelSight Mini; the gel with markers."""

    length_x_mm: float = restated(25.25, minimum=14, maximum=40, source=f"{_GEL}: 25.25 mm")
    length_y_mm: float = restated(20.75, minimum=14, maximum=40, source=f"{_GEL}: 20.75 mm")
    corner_radius_mm: float = restated(
        1.5, minimum=0.5, maximum=5, source=f"{_GEL}: vertical corners R 1.5"
    )
    thickness_mm: float = restated(
        4.0, minimum=2.0, maximum=10,
        source=f"{_GEL}: apex 4.00 mm above the cap's flange. The data sheet's 4.25 +- 0.20 mm "
        "(by third parties) counts from the top of the case, 0.25 mm lower",
    )  # fmt: skip
    crown_radius_x_mm: float = restated(186.3, of=GelPad, minimum=90, source=_FIT)
    crown_radius_y_mm: float = restated(109.7, of=GelPad, minimum=70, source=_FIT)
    crown_pillow: float = restated(
        0.74, of=GelPad, source=f"{_FIT}; chosen to give its volume of 1898.8 mm3"
    )
    rim_mm: float = restated(
        3.247, of=GelPad, minimum=0.5, maximum=3.8,
        source=f"{_FIT}; the arc itself ends 3.193 mm inside the wall",
    )  # fmt: skip
    rim_radius_mm: float = restated(
        5.482, of=GelPad, minimum=4.0, maximum=100,
        source=f"{_FIT}; the arc itself has R 5.563 mm",
    )  # fmt: skip
    rim_drop_mm: float = parameter(
        1.25, minimum=0.4, maximum=1.6, unit="mm", source=f"{_GEL}: wall of 2.75 mm, apex at 4.00",
        description="from the apex down to the upper edge of the wall",
    )  # fmt: skip
    young_modulus_mpa: float = restated(
        0.46,
        source="fit: identified with this solver (ten-node tets, nu 0.48) from press forces that "
        "FEATS measured, see docs/evidence/verification.md; Gent's formula gives 0.41 to 0.47 for "
        "the vendor's 55 Shore 00. Simulators of this gel use 0.01 to 1.0 MPa",
    )
    width_px: int = restated(320, source="gsrobotics default_config.json")
    height_px: int = restated(240, source="gsrobotics default_config.json")
    mm_per_px: float = restated(
        0.0634,
        source="gsrobotics README, by ruler, and gs_sdk gsmini.yaml: 20.3 x 15.2 mm. Others: data "
        "sheet 0.058 x 0.060, Taxim-like 0.059, ManiSkill-ViTac 0.060, TacSL 0.065: crop and the "
        "unit's focus differ",
    )
    raw_width_px: int = restated(3280, source="gsrobotics: 8 MP camera, 3280 x 2464, 25 Hz")
    raw_height_px: int = restated(2464, source="gsrobotics: 8 MP camera, 3280 x 2464, 25 Hz")
    crop_x: float = restated(
        1.0,
        source="assumption: 0.0634 mm/px holds for the whole picture; gsrobotics can cut 0.15 of "
        "it on every side",
    )
    crop_y: float = restated(1.0, source="assumption: as crop_x")
    camera_distance_mm: float = restated(
        24.0, minimum=12, maximum=80,
        source=f"{_ANSYS}, TacEx and ManiSkill-ViTac: 24; TacSL 26.7",
    )  # fmt: skip
    focal_px: float = restated(
        310.9,
        source="24.0 mm seen through window and gel (19.7 mm) over 0.0634 mm/px. "
        "gelsight_ansys_sim uses 412.9 / 402.8 px, ManiSkill-ViTac and TacEx 340 / 325 px: "
        "pictures of other scales",
    )
    led_angle_deg: float | tuple[float, ...] = restated(
        (-90.0, 0.0, 90.0),
        source="fit: ball presses of three units (ruihangao, gs_sdk, Taxim) have red -93 to -104, "
        "green 2 to 7 and blue 79 to 85 deg; other units have these sides turned by 90 deg",
    )
    led_x_mm: float = restated(13.0, source=_LIGHT_FIT)
    led_y_mm: float = restated(11.0, source=_LIGHT_FIT)
    led_depth_mm: float = restated(12.0, source=_LIGHT_FIT)
    led_tilt_deg: float = restated(90.0, source=_LIGHT_FIT)
    led_size_mm: float = restated(2.0, source=_LIGHT_FIT)
    led_length_mm: float = restated(12.0, source=_LIGHT_FIT)
    ambient: float = restated(0.2, source=_LIGHT_FIT)
    window_thickness_mm: float = restated(
        9.5, source=f"{_LIGHT_FIT}: light as flat as captured comes in at the side of thick acrylic"
    )
    marker_pitch_mm: float = restated(
        1.97,
        source=f"{_ANSYS}: 9 dots between margins of 24 px of 320; ManiSkill-ViTac 2.0625",
    )
    marker_pitch_y_mm: float = restated(
        1.90, source=f"{_ANSYS}: 7 dots between margins of 24 px of 240"
    )
    marker_area_x_mm: float = restated(16.5, source=f"{_ANSYS}: 9 columns")
    marker_area_y_mm: float = restated(12.0, source=f"{_ANSYS}: 7 rows")
    marker_radius_mm: float = restated(0.35, source=f"{_ANSYS}: 6 px of 0.0581 mm")
    housing_x_mm: float = restated(32.0, source=f"{_CASE}: 32.0 mm")
    housing_y_mm: float = restated(28.0, source=f"{_CASE}: 28.0 mm")
    housing_z_mm: float = restated(24.0, source=f"{_CASE}: 24.0 mm up to the top of the cap")
    housing_front_mm: float = restated(4.25, source=f"{_CASE}: apex 4.25 mm above the case")
    housing_wall_mm: float = restated(1.25, source=f"{_CASE}: walls of 1 to 1.25 mm")
    housing_offset_mm: ClassVar[tuple[float, float]] = (0.25, -0.5)

    def pad(self) -> GelPad:
        """The gel pad: crown, and a rim that rises as an arc from the wall."""
        try:
            return self.gel_pad(rim="arc", wall_mm=self.thickness_mm - self.rim_drop_mm)
        except InputError as error:
            raise InputError(f"{error} (wall_mm is thickness_mm less rim_drop_mm)") from error


FAMILY = SensorFamily(
    name="gelsight_mini",
    title="GelSight Mini: crowned gel 25.25 x 20.75 x 4.0 mm with a wide rim, 320 x 240 px, dots",
    parameters_type=GelSightMiniParameters,
    references=(
        "Helmut et al., FEATS: gelsight_mini.step (feats-ai/feats, MIT)",
        "GelSight, gsrobotics: shell, README and default_config.json (gelsightinc/gsrobotics)",
        "gelsight_ansys_sim (irisxu02), TacEx, TacSL, ManiSkill-ViTac 2024/2025, Taccel: models of "
        "this sensor with other figures",
    ),
)
