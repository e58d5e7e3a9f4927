# SPDX-License-Identifier: Apache-2.0
"""Pads of real sensors with a flat back, in the dimensions of their sources."""

from __future__ import annotations

from taccel_lab.cad.parts.digit_pad import DigitPad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad

MINI = GelPad(
    length_x_mm=25.25, length_y_mm=20.75, corner_radius_mm=1.5, thickness_mm=4.0,
    crown_radius_x_mm=189, crown_radius_y_mm=114, crown_pillow=0.65,
    rim="arc", rim_mm=3.193, rim_radius_mm=5.563, wall_mm=2.75,
    window_x_mm=20.3, window_y_mm=15.2,
)  # fmt: skip
BEVELLED = GelPad(
    length_x_mm=40, length_y_mm=40, corner_radius_mm=0.3, thickness_mm=5.925,
    rim="chamfer", rim_mm=3.05, wall_mm=2.971, bond_sides="yes",
    window_x_mm=31, window_y_mm=31,
)  # fmt: skip
R15 = GelPad(
    length_x_mm=23.977, length_y_mm=32, corner_radius_mm=1.5, thickness_mm=4,
    window_x_mm=21.05, window_y_mm=28.07,
)  # fmt: skip
WEDGE = GelPad(
    length_x_mm=35, length_y_mm=25.5, corner_radius_mm=1.5, thickness_mm=5.5,
    window_x_mm=28, window_y_mm=20,
)  # fmt: skip
CLASSIC = GelPad(
    length_x_mm=24, length_y_mm=20, corner_radius_mm=2, thickness_mm=5,
    crown_radius_x_mm=50, crown_radius_y_mm=50, window_x_mm=18.88, window_y_mm=14.16,
)  # fmt: skip
SKINNED = GelPad(
    length_x_mm=31.1, length_y_mm=24.1, corner_radius_mm=1.8, thickness_mm=2.8,
    skin_mm=0.3, skin_side_mm=0.8, window_x_mm=23.5, window_y_mm=17.6,
)  # fmt: skip
DIGIT = DigitPad()

PADS: dict[str, HeightPad] = {
    "mini": MINI,
    "bevelled": BEVELLED,
    "r15": R15,
    "wedge": WEDGE,
    "classic": CLASSIC,
    "skinned": SKINNED,
    "digit": DIGIT,
}
