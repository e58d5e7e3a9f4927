# SPDX-License-Identifier: Apache-2.0
"""A small sensor for tests of assemblies and files: domed gel, plate, housing, camera, LEDs."""

from __future__ import annotations

import math
from dataclasses import replace

from taccel_lab.cad.assembly import Assembly, sensor_assembly
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.housing_shape import HousingShape
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.cad.parts.part import gel_part
from taccel_lab.profile.optical_design import DesignedCamera, Light, Window

PAD = GelPad(crown_radius_x_mm=50.0, crown_radius_y_mm=50.0, thickness_mm=5.0)
WINDOW = Window(3.0, (24.0, 20.0))
VIEW_MM = (18.0, 14.0)
HOUSING = HousingShape((30.0, 26.0, 30.0), 1.5, front_z_mm=-3.5)
CAMERA = DesignedCamera(640, 480, 800.0, 800.0, 319.5, 239.5, (0.0, 0.0, -30.0))


def led(name: str, angle: float) -> Light:
    """An LED at the wall that shines inward."""
    c, s = math.cos(angle), math.sin(angle)
    place, inward = (12.5 * c, 10.0 * s, -12.0), (-c, -s, 0.0)
    return Light(place, inward, (1.0, 1.0, 1.0), (1.0, 1.0), name=name)


LEDS = (led("red", 0.0), led("green", math.pi), led("blue", math.pi / 2))


def small_sensor(**changes: object) -> Assembly:
    """The sensor, with some of sensor_assembly's arguments changed."""
    options: dict[str, object] = {
        "window": WINDOW, "housing": HOUSING, "cameras": (CAMERA,), "leds": LEDS,
        "view_mm": VIEW_MM, **changes,
    }  # fmt: skip
    gel = (gel_part(labelled_solid(PAD)),)
    return sensor_assembly("small", gel, PAD.thickness_mm, **options)  # type: ignore[arg-type]


def housing(**changes: object) -> HousingShape:
    """The housing with some dimensions changed."""
    return replace(HOUSING, **changes)  # type: ignore[arg-type]
