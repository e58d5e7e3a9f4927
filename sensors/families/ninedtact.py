# SPDX-License-Identifier: Apache-2.0
"""9DTact: a flat translucent gel under a black skin; white light, grey stands for depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import restated
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.sensors.base import GelMaterial, SensorFamily
from taccel_lab.sensors.camera_sensor import RectangleSensorParameters
from taccel_lab.sensors.parameter_groups.material import SkinParameters

_MOULD = "measured on the mould drawings of 9DTact (linchangyi1/9DTact, MIT)"
_SHELL = "measured on the shell of 9DTact (linchangyi1/9DTact, MIT)"
_CALIBRATION = "rectification maps of 9DTact (linchangyi1/9DTact, MIT)"
_SAME_SILICONE = "assumption: the same silicone as the core with black pigment; none is published"


@dataclass(frozen=True)
class NineDTactParameters(RectangleSensorParameters):
    """Parameters of a 9DTact; its outer dimensions include the skin."""

    groups: ClassVar = (SkinParameters,)

    length_x_mm: float = restated(31.1, minimum=14, source=f"{_MOULD}: black skin 31.1 x 24.1 mm")
    length_y_mm: float = restated(24.1, minimum=14, source=f"{_MOULD}: black skin 31.1 x 24.1 mm")
    corner_radius_mm: float = restated(
        1.8, minimum=1.2, maximum=6, source=f"{_MOULD}: outside of the skin R 1.8, core R 1.0"
    )
    thickness_mm: float = restated(
        2.8, minimum=0.8, maximum=8, source=f"{_MOULD}: mould of 2.8 mm, core of 2.5 mm",
        description="gel thickness with the skin",
    )  # fmt: skip
    skin_top_mm: float = restated(
        0.3, of=GelPad, minimum=0.1, maximum=1.0, zero_means="",
        source=f"{_MOULD}: 2.8 mm less 2.5 mm",
    )  # fmt: skip
    skin_side_mm: float = restated(
        0.8, of=GelPad, minimum=0.2, maximum=1.0, zero_means="",
        source=f"{_MOULD}: (31.1 - 29.5) / 2 = (24.1 - 22.5) / 2 mm",
    )  # fmt: skip
    young_modulus_mpa: float = restated(
        0.2, source="assumption: soft translucent silicone; no modulus of this gel is published"
    )
    skin_young_modulus_mpa: float = restated(0.0, source=_SAME_SILICONE)
    skin_density_kg_m3: float = restated(1000.0, source=_SAME_SILICONE)
    width_px: int = restated(460, source=f"{_CALIBRATION}: crop of 460 x 345 px")
    height_px: int = restated(345, source=f"{_CALIBRATION}: crop of 460 x 345 px")
    mm_per_px: float = restated(
        0.0505,
        source=f"{_CALIBRATION}: 0.0510 and 0.0500 mm/px of two units, 23.2 x 17.4 mm",
    )
    raw_width_px: int = restated(640, source="9DTact configuration: 640 x 480 px at 30 Hz")
    raw_height_px: int = restated(480, source="9DTact configuration: 640 x 480 px at 30 Hz")
    crop_x: float = restated(0.71875, source=f"{_CALIBRATION}: 460 of 640 px")
    crop_y: float = restated(0.71875, source=f"{_CALIBRATION}: 345 of 480 px")
    camera_distance_mm: float = restated(
        17.0, minimum=12, maximum=60,
        source="9DTact: lens focused at about 15 mm, which through window and gel is 17 mm",
    )  # fmt: skip
    focal_px: float = restated(297.0, source="15 mm over 0.0505 mm/px")
    window_thickness_mm: float = restated(
        3.5, maximum=8,
        source=f"{_SHELL}: rim 6.3 mm above the floor, less the gel; the acrylic's own drawing "
        "could not be read",
    )  # fmt: skip
    gel_scattering_per_mm: float = restated(
        0.3,
        source="fit: a ball press of the authors' data keeps 0.7 of its contrast, correlation 0.99",
    )
    ambient: float = restated(
        2.0, source="fit: the authors' backgrounds are nearly even, so most light is scattered"
    )
    led_angle_deg: float | tuple[float, ...] = restated(
        (0.0, 90.0, 180.0, 270.0),
        source="assumption: white LEDs on four sides",
    )
    led_colors: str | tuple[str, ...] = restated("white", source="9DTact: white LEDs")
    led_x_mm: float = restated(9.0, source="assumption: white LEDs round the aperture of 12 mm")
    led_y_mm: float = restated(9.0, source="assumption: white LEDs round the aperture of 12 mm")
    led_tilt_deg: float = restated(0.0, source="assumption: LEDs face the gel")
    coating_albedo: float = restated(0.02, source="assumption: black skin")
    coating_thickness_mm: float = restated(
        0.0, source="the skin is a separate solid, see skin_top_mm"
    )
    housing_x_mm: float = restated(32.5, source=f"{_SHELL}: 32.5 x 25.5 mm")
    housing_y_mm: float = restated(25.5, source=f"{_SHELL}: 32.5 x 25.5 mm")
    housing_z_mm: float = restated(22.7, source=f"{_SHELL}: 25.5 mm in all less 2.8 mm of gel")
    housing_front_mm: float = restated(2.8, source="assumption: level with the back of the gel")
    housing_corner_mm: float = restated(2.0, source=f"{_SHELL}: R 2")

    def pad(self) -> GelPad:
        """The flat pad: translucent core and black skin."""
        return self.gel_pad(inset_mm=self.skin_side_mm)

    def layer_materials(self) -> tuple[GelMaterial, ...]:
        """Translucent core, black skin."""
        return (
            self.material(),
            self.group(SkinParameters).skin_material(self.material()),
        )


FAMILY = SensorFamily(
    name="9dtact",
    title="9DTact: flat gel 31.1 x 24.1 x 2.8 mm, translucent under a black skin, 460 x 345 px",
    parameters_type=NineDTactParameters,
    references=(
        "Lin et al., 9DTact: A Compact Vision-Based Tactile Sensor for Accurate 3D Shape "
        "Reconstruction and Generalizable 6D Force Estimation, RA-L 2023 (linchangyi1/9DTact, MIT)",
    ),
)
