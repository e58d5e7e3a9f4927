# SPDX-License-Identifier: Apache-2.0
"""LEDs around the optical axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.profile.optical_design import Light, Triple
from taccel_lab.sensors.base import NO_FIGURE

RED, GREEN, BLUE, WHITE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0)
"""Ideal LEDs: each colour reaches one channel of the camera only."""
_COLORS = {"red": RED, "green": GREEN, "blue": BLUE, "white": WHITE}


@dataclass(frozen=True)
class LightParameters(ParameterSet):
    """LEDs around the optical axis, all of one kind; a family says which colours stand where,
    unless ``led_count`` asks for a ring of them."""

    parameter_group: ClassVar[str] = "lights"

    led_count: int = parameter(
        0, minimum=1, maximum=64, zero_means="where the family has them",
        source="assumption: as the family's sources place them",
        description="LEDs in a ring, at equal angles",
    )  # fmt: skip
    led_start_deg: float = parameter(
        0.0, minimum=-360, maximum=360, unit="deg", source="assumption: the first one lies at +x",
        description="angle of a ring's first LED, from +x towards +y",
    )  # fmt: skip
    led_colors: str = parameter(
        "rgb", choices=("rgb", "hue", "white", "red", "green", "blue"),
        source="assumption: red, green and blue in turn, as in most photometric sensors",
        description="colours of a ring's LEDs: rgb in turn, hue once round the colours, or one",
    )  # fmt: skip
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

    def ring(self) -> tuple[Light, ...]:
        """``led_count`` LEDs at equal angles."""
        found = []
        for k in range(self.led_count):
            angle = self.led_start_deg + 360.0 * k / self.led_count
            color = "rgb" if self.led_colors == "hue" else self.led_colors
            rgb = _hue(360.0 * k / self.led_count)
            if self.led_colors != "hue":
                color = ("red", "green", "blue")[k % 3] if color == "rgb" else color
                rgb = _COLORS[color]
            found.append(self.led(angle, rgb, f"{color} {k}"))
        return tuple(found)

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


def _hue(angle_deg: float) -> Triple:
    """Red at 0, green at 120, blue at 240 deg, mixed between."""
    red, green, blue = (
        max(0.0, math.cos(math.radians(angle_deg - at)) + 0.5) / 1.5 for at in (0.0, 120.0, 240.0)
    )
    return red, green, blue
