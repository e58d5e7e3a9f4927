# SPDX-License-Identifier: Apache-2.0
"""R-Tac, the dome of PP-Tac: a thin soft shell cast over a hard transparent dome."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import restated
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.profile.optical_design import Window
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.camera_sensor import CameraSensorParameters

_SHELL = "measured on the parts of PP-Tac (bigai-ai/PP-Tac, figures only)"
_CALIBRATION = "camera calibration of PP-Tac, OV9281, 640 x 480 px"


@dataclass(frozen=True)
class RTacParameters(CameraSensorParameters):
    """Parameters of an R-Tac: Ecoflex 00-10 on a dome of PDMS, monochrome camera, white light."""

    dome_radius_mm: float = restated(
        15.0, of=ShellDomePad, minimum=8, maximum=30,
        source=f"{_SHELL}: hemisphere R 15.0",
    )  # fmt: skip
    thickness_mm: float = restated(
        1.5, of=ShellDomePad, minimum=0.6, maximum=3.5,
        source=f"{_SHELL}: R 15.0 over a core of R 13.5",
    )  # fmt: skip
    young_modulus_mpa: float = restated(
        0.055,
        source="Ecoflex 00-10, 100 % modulus 55 kPa by its data sheet, taken as Young's modulus "
        "(an assumption: it stiffens less than linearly)",
    )
    width_px: int = restated(640, source=_CALIBRATION)
    height_px: int = restated(480, source=_CALIBRATION)
    mm_per_px: float = restated(
        0.069,
        source=f"{_CALIBRATION}: apex at 22.02 mm, seen through dome and gel at 20.7 mm, over 300 "
        "px; the picture itself is finer towards the dome's edge",
    )
    raw_width_px: int = restated(640, source="OV9281: monochrome, 640 x 480 px at 120 Hz")
    raw_height_px: int = restated(480, source="OV9281: monochrome, 640 x 480 px at 120 Hz")
    camera_distance_mm: float = restated(
        22.02, minimum=8, maximum=80,
        source=f"{_CALIBRATION}: 7.02 mm to the dome's centre, and its radius of 15.0 mm",
    )  # fmt: skip
    focal_px: float = restated(299.9, source=f"{_CALIBRATION}: 299.97 / 299.82 px")
    principal_x_px: float = restated(5.7, source=f"{_CALIBRATION}: column 325.2")
    principal_y_px: float = restated(25.4, source=f"{_CALIBRATION}: row 264.9")
    lens_distortion: ClassVar[tuple[float, ...]] = (-0.26, 0.087, 0.0, -0.0002, -0.015)
    camera_x_mm: float | tuple[float, ...] = restated(-0.27, source=_CALIBRATION)
    camera_y_mm: float | tuple[float, ...] = restated(1.07, source=_CALIBRATION)
    led_count: int = restated(8, zero_means="", source="assumption: a ring under the dome's edge")
    led_colors: str = restated("white", source="white LEDs of type 2835")
    led_x_mm: float = restated(11.0, source="assumption: a ring under the dome's edge")
    led_y_mm: float = restated(11.0, source="assumption: a ring under the dome's edge")
    led_depth_mm: float = restated(16.0, source="assumption: white 2835 LEDs under the dome")
    led_tilt_deg: float = restated(0.0, source="assumption: LEDs face the dome")
    led_size_mm: float = restated(
        3.0, source="white LEDs of type 2835 (2.8 x 3.5 mm) behind a diffuser of 2 mm"
    )
    coating_albedo: float = restated(
        0.1, source="assumption: Psycho Paint with black pigment reflects little"
    )
    window_thickness_mm: float = restated(
        3.0, minimum=0.8, maximum=4,
        source="assumption: the wall of the PDMS dome; its inside is not published",
    )  # fmt: skip
    window_index: float = restated(1.41, source="PDMS (Sylgard 184): 1.41 in visible light")
    housing_x_mm: float = restated(30.0, source=f"{_SHELL}: 30 mm")
    housing_y_mm: float = restated(30.0, source=f"{_SHELL}: 30 mm")
    housing_z_mm: float = restated(21.65, source=f"{_SHELL}: 21.65 mm")
    housing_front_mm: float = restated(15.0, source=f"{_SHELL}: the dome is a hemisphere")

    def pad(self) -> ShellDomePad:
        """The soft shell; all of its inside and its rim are glued."""
        return self.part(ShellDomePad)

    def window(self) -> Window:
        """The hard dome under the gel."""
        radius = self.dome_radius_mm - self.thickness_mm
        return Window(
            thickness_mm=self.window_thickness_mm,
            size_mm=(2 * radius, 2 * radius),
            refractive_index=self.window_index,
            shape="dome",
            outer_radius_mm=radius,
        )


FAMILY = SensorFamily(
    name="rtac",
    title="R-Tac (PP-Tac): soft shell of 1.5 mm on a hard dome, R 15.0 mm, monochrome camera",
    parameters_type=RTacParameters,
    references=(
        "Lin et al., PP-Tac: Paper Picking Using Tactile Feedback in Dexterous Robotic Hands, 2025 "
        "(bigai-ai/PP-Tac, no licence stated: figures only)",
    ),
)
