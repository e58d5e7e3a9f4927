# SPDX-License-Identifier: Apache-2.0
"""LEDs around the optical axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.optics.description import Light, Triple
from taccel_lab.sensors.base import NO_FIGURE

RED, GREEN, BLUE, WHITE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0)
"""Ideal LEDs: each colour reaches one channel of the camera only."""


@dataclass(frozen=True)
class LightParameters(ParameterSet):
    """LEDs around the optical axis, all of one kind; a family says which colours stand where."""

    parameter_group: ClassVar[str] = "lights"

    led_x_mm: float = parameter(
        12.0, minimum=1, maximum=100, unit="mm", source=NO_FIGURE,
        description="distance of the LEDs at the sides +x and -x from the optical axis",
    )  # fmt: skip
    led_y_mm: float = parameter(
        12.0, minimum=1, maximum=100, unit="mm", source=NO_FIGURE,
        description="distance of the LEDs at the sides +y and -y from the optical axis",
    )  # fmt: skip
    led_depth_mm: float = parameter(
        8.0, minimum=0.1, maximum=100, unit="mm", source=NO_FIGURE,
        description="distance of the LEDs behind the apex of the contact face",
    )  # fmt: skip
    led_tilt_deg: float = parameter(
        60.0, minimum=0.0, maximum=120, unit="deg", source=NO_FIGURE,
        description="angle between an LED's axis and the normal of the gel: 0 shines straight at "
        "the gel, 90 across it",
    )  # fmt: skip
    led_size_mm: float = parameter(
        1.0, minimum=0.0, maximum=50, unit="mm", source=NO_FIGURE,
        description="edge of an LED's square emitting face",
    )  # fmt: skip
    led_lobe: float = parameter(
        1.0, minimum=0.0, maximum=60,
        source="assumption: a bare LED is close to a Lambertian emitter",
        description="exponent n of the emission lobe cos^n",
    )  # fmt: skip
    led_length_mm: float = parameter(
        0.0, minimum=0.1, maximum=100, unit="mm", zero_means="square LEDs",
        source="assumption: single LEDs",
        description="length of the emitting faces along their side, for strips of LEDs",
    )  # fmt: skip
    ambient: float = parameter(
        1.0, minimum=0.0, maximum=5.0,
        source="assumption: what the housing throws about, as fits to captures of the classic "
        "GelSight and of a GelSight Mini have it (1.0)",
        description="even light on all of the coating, as a share of the mean direct light on the "
        "visible gel at rest",
    )  # fmt: skip

    def led(self, angle_deg: float, rgb: Triple, name: str) -> Light:
        """The LED, or strip, seen at ``angle_deg`` from +x towards +y."""
        angle, tilt = math.radians(angle_deg), math.radians(self.led_tilt_deg)
        c, s = math.cos(angle), math.sin(angle)
        side = math.sin(tilt)
        return Light(
            position_mm=(self.led_x_mm * c, self.led_y_mm * s, -self.led_depth_mm),
            direction=(-side * c, -side * s, math.cos(tilt)),
            rgb=rgb,
            size_mm=(self.led_length_mm or self.led_size_mm, self.led_size_mm),
            lobe=self.led_lobe,
            name=name,
        )
