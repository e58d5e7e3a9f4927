# SPDX-License-Identifier: Apache-2.0
"""DIGIT: a thumb-shaped gel on a D-shaped outline in a moulded finger."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import parameter, restated
from taccel_lab.cad.parts.digit_pad import DigitPad, flatter_radius
from taccel_lab.cad.parts.height_pad import MIN_WALL_MM
from taccel_lab.profile.optical_design import Window
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.camera_sensor import CameraSensorParameters
from taccel_lab.sensors.parameter_groups.parts import WindowParameters

_PARTS = "measured on the parts of digit-design (facebookresearch, figures only)"
_LIGHT_FIT = (
    "fit: best of a search against six ball presses of FOTS, labelled by eye (colour cosine 0.70, "
    "contrast 0.73 of the captured)"
)
_RIM_FROM = 0.8
"""Part of the crown's drop from which the edge is filleted: a flatter one has a low wall, on which
a fillet meshes badly (4 to 9 deg), and is sharp (12 deg and more)."""
_CANFNET = "camera calibration of CANFNet, 240 x 320 px"


@dataclass(frozen=True)
class DigitParameters(CameraSensorParameters):
    """Parameters of a DIGIT; the fingertip points to +y."""

    width_mm: float = restated(of=DigitPad, minimum=12, maximum=26)
    length_mm: float = restated(of=DigitPad, minimum=20, maximum=45)
    thickness_mm: float = restated(of=DigitPad, minimum=0.8, maximum=12)
    mid_radius_mm: float = restated(of=DigitPad, minimum=17, maximum=400)
    base_corner_mm: float = restated(of=DigitPad, minimum=1.3, maximum=4)
    roll_off: float = restated(of=DigitPad, maximum=1.5)
    rim_mm: float = restated(of=DigitPad, maximum=1.15, zero_means="")
    thin_crown: str = parameter(
        "flattened", choices=("flattened", "kept"),
        source="assumption: thin gels of this outline are cast flatter; no drawing of one is "
        "published",
        description="crown and rim of a gel thinner than 4.07 mm: flattened with the thickness, "
        "so that a wall stays, below 3.3 mm with a sharp edge, or kept; mid_radius_mm=0 roll_off=0 "
        "are flat at any thickness",
    )  # fmt: skip
    young_modulus_mpa: float = restated(
        0.3,
        source="assumption: Smooth-On Solaris with Slacker, Shore A 10 to 15 by the build guide "
        "before Slacker; no modulus of this gel is published. TACTO has none, Taccel's default "
        "is 0.5",
    )
    width_px: int = restated(240, source="usual stream of a DIGIT, portrait")
    height_px: int = restated(320, source="usual stream of a DIGIT, portrait")
    mm_per_px: float = restated(
        0.0536,
        source=f"{_CANFNET}: 17.62 mm over 328.57 px, 12.9 x 17.2 mm. Others: 0.0582 (AUROVA, by "
        "ball), 0.0532 (Taxim, 0.0266 at 640), 0.0405 at 320 (gs_sdk, cropped); the paper "
        "speaks of 19 x 16 mm",
    )
    raw_width_px: int = restated(480, source="OVM7692: 640 x 480 at 60 Hz, turned upright")
    raw_height_px: int = restated(640, source="OVM7692: 640 x 480 at 60 Hz, turned upright")
    camera_distance_mm: float = restated(
        20.8, minimum=15, maximum=60,
        source=f"{_CANFNET}: seen at 17.62 mm, through 6.15 mm of acrylic and 4.07 mm of gel",
    )  # fmt: skip
    focal_px: float = restated(328.57, source=_CANFNET)
    principal_x_px: float = restated(-5.0, source=f"{_CANFNET}: column 114.5")
    principal_y_px: float = restated(-1.9, source=f"{_CANFNET}: row 157.6")
    window_thickness_mm: float = restated(
        6.15, maximum=8,
        source="acrylic of digit-design: 6.15 in its CAD, 5.5 as shipped, 4 in the build guide; "
        "4 to 6.2 are accepted",
    )  # fmt: skip
    led_angle_deg: float | tuple[float, ...] = restated(
        (-45.0, -135.0, 90.0),
        source="fit: shading of 12 presses of FOTS has red -64, green -141 and blue 86 deg, "
        "TACTO 30, 150 and 270 deg; these lie between",
    )
    led_x_mm: float = restated(9.7, source=_LIGHT_FIT)
    led_y_mm: float = restated(12.6, source=_LIGHT_FIT)
    led_depth_mm: float = restated(8.0, source=_LIGHT_FIT)
    led_tilt_deg: float = restated(90.0, source=_LIGHT_FIT)
    led_size_mm: float = restated(2.0, source=_LIGHT_FIT)
    ambient: float = restated(0.2, source=_LIGHT_FIT)
    housing_x_mm: float = restated(26.95, source=f"{_PARTS}: 26.95 mm")
    housing_y_mm: float = restated(34.01, source=f"{_PARTS}: 34.01 mm")
    housing_z_mm: float = restated(28.4, source=f"{_PARTS}: 28.4 mm in three parts")
    housing_front_mm: float = restated(4.1, source="assumption: level with the back of the gel")
    lens_distortion: ClassVar[tuple[float, ...]] = (-0.0066, -0.398, 0.0029, -0.0049, 1.169)

    def pad(self) -> DigitPad:
        """The gel pad."""
        window_x, window_y = self._seen_inside_tip_mm()
        part = 1.0 if self.thin_crown == "kept" else self._crown_part()
        return self.part(
            DigitPad,
            mid_radius_mm=flatter_radius(self.mid_radius_mm, self.width_mm / 2, part),
            roll_off=self.roll_off * part,
            rim_mm=self.rim_mm if part > _RIM_FROM else 0.0,
            window_x_mm=window_x,
            window_y_mm=window_y,
        )

    def _crown_part(self) -> float:
        """Drops of the crown as parts of those of the DIGIT's own gel: 1 at its thickness, 0 where
        nothing but the least wall would be left."""
        own = DigitPad.parameters()["thickness_mm"].default
        return min((self.thickness_mm - MIN_WALL_MM) / (own - MIN_WALL_MM), 1.0)

    def _seen_inside_tip_mm(self) -> tuple[float, float]:
        """What the image shows, cut so that its corners stay inside the round tip."""
        x, y = self.seen_mm(self.width_mm, self.length_mm, 1.0)
        radius = self.width_mm / 2
        tip = self.length_mm / 2 - radius + math.sqrt((radius - 0.25) ** 2 - (x / 2) ** 2)
        return x, min(y, 2 * tip)

    def window(self) -> Window:
        """The acrylic plate, 0.1 mm narrower than the gel."""
        return Window(
            thickness_mm=self.window_thickness_mm,
            size_mm=(self.width_mm - 0.1, self.length_mm),
            refractive_index=self.group(WindowParameters).window_index,
        )


FAMILY = SensorFamily(
    name="digit",
    title="DIGIT: thumb-shaped gel 18.4 x 25.0 x 4.07 mm, mid-section R 21.4, 240 x 320 px",
    parameters_type=DigitParameters,
    references=(
        "Lambeta et al., DIGIT, RA-L 2020; digit-design (facebookresearch, CC BY-NC 4.0: figures "
        "only, no file or drawing is taken over)",
        "CANFNet (paulotto/canfnet): camera calibration",
    ),
)
