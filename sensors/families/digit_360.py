# SPDX-License-Identifier: Apache-2.0
"""DIGIT 360: a full hemisphere of gel, glued to a hyper-fisheye lens that looks into it."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.cad.parameters import restated
from taccel_lab.cad.parts.dome_pad import SolidDomePad
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.camera_sensor import CameraSensorParameters

_TIP = "measured on the fingertip of digit360 (facebookresearch, figures only)"


@dataclass(frozen=True)
class Digit360Parameters(CameraSensorParameters):
    """Parameters of a DIGIT 360; its lens is glued into a pocket in the base of the gel.

    The tactile image shows the gel from above, which no single scale of a fisheye's picture does:
    the lens makes equal angles equally large. Its focal length stands apart from the image's scale.
    """

    dome_radius_mm: float = restated(
        12.5, of=SolidDomePad, minimum=8, maximum=25,
        source=f"{_TIP}: hemisphere R 12.5",
    )  # fmt: skip
    wall_height_mm: float = restated(
        13.5, of=SolidDomePad, minimum=4, maximum=40,
        source=f"{_TIP}: 26.0 mm in all",
    )  # fmt: skip
    pocket_radius_mm: float = restated(
        4.927, of=SolidDomePad, minimum=2, maximum=6,
        source=f"{_TIP}: cone of 2 deg from 4.927 to 4.879 mm",
    )  # fmt: skip
    pocket_depth_mm: float = restated(
        1.55, of=SolidDomePad, minimum=1.0, maximum=4,
        source=f"{_TIP}: about 1.55 mm",
    )  # fmt: skip
    pocket_dome_radius_mm: float = restated(
        7.439, of=SolidDomePad, minimum=6.5, maximum=100,
        source=f"{_TIP}: sphere R 7.439, the lens's outer element",
    )  # fmt: skip
    young_modulus_mpa: float = restated(
        0.3, source="assumption: hardness and modulus of this gel are not published"
    )
    width_px: int = restated(640, source="assumption: the dome from above in 640 x 640 px")
    height_px: int = restated(640, source="assumption: the dome from above in 640 x 640 px")
    mm_per_px: float = restated(
        0.04,
        source="assumption: 25.6 mm, the whole dome. The picture of the fisheye itself is finer at "
        "the rim and coarser at the apex, see focal_px",
    )
    raw_width_px: int = restated(4208, source="AR1335: 13 MP, 4208 x 3120 px")
    raw_height_px: int = restated(3120, source="AR1335: 13 MP, 4208 x 3120 px")
    crop_x: float = restated(0.74, source="assumption: the image circle, as high as the picture")
    camera_distance_mm: float = restated(
        24.2, minimum=8, maximum=70,
        source="assumption: entrance pupil 1.5 mm behind the pocket's ceiling, which lies 22.7 mm "
        "below the apex",
    )  # fmt: skip
    focal_px: float = restated(203.7, source="assumption: equidistant fisheye, 180 deg over 640 px")
    lens_model: str = restated("fisheye", source=f"{_TIP}: hyper-fisheye of 200 deg and more")
    led_count: int = restated(8, zero_means="", source=f"{_TIP}: eight RGB LEDs in a ring")
    led_colors: str = restated("hue", source="assumption: their hue goes once round the colours")
    led_x_mm: float = restated(9.0, source=f"{_TIP}: ring PCB, bore 11.6, outside 24.9 mm")
    led_y_mm: float = restated(9.0, source=f"{_TIP}: ring PCB, bore 11.6, outside 24.9 mm")
    led_depth_mm: float = restated(26.0, source=f"{_TIP}: ring PCB at the base of the gel")
    led_tilt_deg: float = restated(0.0, source="assumption: LEDs face the gel")
    housing_x_mm: float = restated(33.0, source="digit360_mesh: 33 x 28 x 53 mm with the gel")
    housing_y_mm: float = restated(28.0, source="digit360_mesh: 33 x 28 x 53 mm with the gel")
    housing_z_mm: float = restated(27.0, source="digit360_mesh: 53 mm less 26 mm of gel")
    housing_front_mm: float = restated(26.0, source=f"{_TIP}: base of the gel")

    def gel_depth_mm(self) -> float:
        """Gel between the apex and the lens."""
        return self.pad().thickness_mm

    def focal_lengths_px(self) -> tuple[float, float]:
        """Focal lengths in pixels for each radian of angle."""
        return self.lens_px(), self.lens_px()

    def apparent_distance_mm(self) -> float:
        """The camera's own distance: its lens is made for looking into the gel."""
        return self.camera_distance_mm

    def pad(self) -> SolidDomePad:
        """The gel: hemisphere on a cylinder with the lens pocket."""
        return self.part(SolidDomePad, pocket_taper_deg=2.0, pocket_edge_radius_mm=0.25)

    def window(self) -> None:
        """None: the lens itself is glued into the gel."""
        return None


FAMILY = SensorFamily(
    name="digit_360",
    title="DIGIT 360: gel hemisphere R 12.5 mm on a cylinder, 26 mm high, hyper-fisheye inside",
    parameters_type=Digit360Parameters,
    references=(
        "Lambeta et al., Digitizing Touch with an Artificial Multimodal Fingertip, arXiv "
        "2411.02479; digit360 (facebookresearch, CC BY-NC 4.0: figures only, no file or drawing "
        "is taken over)",
    ),
)
