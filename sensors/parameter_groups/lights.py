# SPDX-License-Identifier: Apache-2.0
"""LEDs and light guides around the optical axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import Light, Triple
from taccel_lab.sensors.base import NO_FIGURE

_COLORS: dict[str, Triple] = {
    "red": (1.0, 0.0, 0.0), "green": (0.0, 1.0, 0.0), "blue": (0.0, 0.0, 1.0),
    "white": (1.0, 1.0, 1.0),
}  # fmt: skip
"""Ideal LEDs: each of the first three reaches one channel of the camera only."""
_IN_TURN = ("red", "green", "blue")


@dataclass(frozen=True)
class LightParameters(ParameterSet):
    """LEDs around the optical axis, and exits of light guides, which are LEDs with a length.

    Every value is one for all, or one for each of them, which are taken in turn.
    """

    parameter_group: ClassVar[str] = "lights"

    led_count: int = parameter(
        0, minimum=1, maximum=64, zero_means="as many as led_angle_deg has",
        source="assumption: as the family's sources place them",
        description="number of LEDs",
    )  # fmt: skip
    led_angle_deg: float | tuple[float, ...] = parameter(
        0.0, minimum=-360, maximum=360, unit="deg", each="LED",
        source="assumption: the first one lies at +x",
        description="where each LED lies, from +x towards +y; a single value is that of the first "
        "one in a ring of equal angles",
    )  # fmt: skip
    led_colors: str | tuple[str, ...] = parameter(
        "rgb", choices=("rgb", "hue", *_COLORS), each="LED",
        pattern=("#[0-9a-fA-F]{6}", "#rrggbb"),
        source="assumption: red, green and blue in turn, as in most photometric sensors",
        description="colours of the LEDs: rgb is red, green and blue in turn, hue once round the "
        "colours",
    )  # fmt: skip
    led_power: float | tuple[float, ...] = parameter(
        1.0, minimum=0.01, maximum=100, each="LED", source="assumption: all LEDs are driven alike",
        description="radiant power, relative to the other LEDs",
    )  # fmt: skip
    led_x_mm: float | tuple[float, ...] = parameter(
        12.0, minimum=1, maximum=100, unit="mm", source=NO_FIGURE, each="LED",
        description="distance of the LEDs at the sides +x and -x from the optical axis",
    )  # fmt: skip
    led_y_mm: float | tuple[float, ...] = parameter(
        12.0, minimum=1, maximum=100, unit="mm", source=NO_FIGURE, each="LED",
        description="distance of the LEDs at the sides +y and -y from the optical axis",
    )  # fmt: skip
    led_depth_mm: float | tuple[float, ...] = parameter(
        8.0, minimum=0.1, maximum=100, unit="mm", source=NO_FIGURE, each="LED",
        description="distance of the LEDs behind the apex of the contact face",
    )  # fmt: skip
    led_tilt_deg: float | tuple[float, ...] = parameter(
        60.0, minimum=0.0, maximum=120, unit="deg", source=NO_FIGURE, each="LED",
        description="angle between an LED's axis and the normal of the gel: 0 shines straight at "
        "the gel, 90 across it",
    )  # fmt: skip
    led_turn_deg: float | tuple[float, ...] = parameter(
        0.0, minimum=-180, maximum=180, unit="deg", each="LED",
        source="assumption: LEDs face the optical axis",
        description="turn of an LED's axis about the normal, from the optical axis",
    )  # fmt: skip
    led_size_mm: float | tuple[float, ...] = parameter(
        1.0, minimum=0.0, maximum=50, unit="mm", source=NO_FIGURE, each="LED",
        description="edge of an LED's square emitting face, or height of a light guide's exit",
    )  # fmt: skip
    led_length_mm: float | tuple[float, ...] = parameter(
        0.0, minimum=0.1, maximum=100, unit="mm", zero_means="square LEDs", each="LED",
        source="assumption: single LEDs",
        description="length of the emitting faces along their side: of strips of LEDs, or of the "
        "straight exits of light guides",
    )  # fmt: skip
    led_arc_deg: float | tuple[float, ...] = parameter(
        0.0, minimum=1, maximum=360, unit="deg", zero_means="straight", each="LED",
        source="assumption: straight faces",
        description="angle about the optical axis over which the exit of a bent light guide "
        "reaches, in place of a length; 360 is a ring",
    )  # fmt: skip
    led_lobe: float | tuple[float, ...] = parameter(
        1.0, minimum=0.0, maximum=60, each="LED",
        source="assumption: a bare LED is close to a Lambertian emitter",
        description="exponent n of the emission lobe cos^n",
    )  # fmt: skip
    led_half_angle_deg: float | tuple[float, ...] = parameter(
        0.0, minimum=5, maximum=89, unit="deg", zero_means="led_lobe says it", each="LED",
        source="assumption: no data sheet is known",
        description="angle off the axis at which an LED has half its intensity, half of the "
        "viewing angle of data sheets; 60 is a Lambertian emitter",
    )  # fmt: skip
    ambient: float = parameter(
        1.0, minimum=0.0, maximum=5.0,
        source="assumption: what the housing throws about, as fits to captures of the classic "
        "GelSight and of a GelSight Mini have it (1.0)",
        description="even light on all of the coating, as a share of the mean direct light on the "
        "visible gel at rest",
    )  # fmt: skip

    def lights(self) -> tuple[Light, ...]:
        """The LEDs; InputError for values that are neither one nor one for each."""
        angles = self._angles_deg()
        colors = [self._color(k, len(angles)) for k in range(len(angles))]
        names = [name for name, _ in colors]
        if len(set(names)) < len(names):
            names = [f"{name} {k}" for k, name in enumerate(names)]
        return tuple(
            self._light(k, len(angles), angle, rgb, name)
            for k, (angle, (_, rgb), name) in enumerate(zip(angles, colors, names, strict=True))
        )

    def _angles_deg(self) -> list[float]:
        count, given = self.led_count, self.led_angle_deg
        if not isinstance(given, tuple):
            count = count or 1
            return [given + 360.0 * k / count for k in range(count)]
        if count not in (0, len(given)):
            raise InputError(
                f"led_count = {count}, but led_angle_deg has {len(given)} values; give as many, or "
                "one, such as led_angle_deg=0, for a ring"
            )
        return list(given)

    def _of(self, name: str, k: int, count: int) -> Any:
        """The value of one of ``count`` LEDs."""
        value = getattr(self, name)
        if not isinstance(value, tuple):
            return value
        if count % len(value):
            raise InputError(
                f"{name} has {len(value)} values for {count} LEDs; give one, or one for each"
            )
        return value[k % len(value)]

    def _color(self, k: int, count: int) -> tuple[str, Triple]:
        name = self._of("led_colors", k, count)
        if name == "rgb":
            name = _IN_TURN[k % 3]
        if name == "hue":
            return name, _hue(360.0 * k / count)
        if name in _COLORS:
            return name, _COLORS[name]
        red, green, blue = (int(name[at : at + 2], 16) / 255 for at in (1, 3, 5))
        if not max(red, green, blue):
            raise InputError("led_colors = #000000 is no light; take led_count down instead")
        return name, (red, green, blue)

    def _light(self, k: int, count: int, angle_deg: float, rgb: Triple, name: str) -> Light:
        def own(parameter: str) -> float:
            return self._of(f"led_{parameter}", k, count)

        angle, tilt = math.radians(angle_deg), math.radians(own("tilt_deg"))
        ahead = angle + math.radians(own("turn_deg"))
        side, size, arc = math.sin(tilt), own("size_mm"), own("arc_deg")
        half, power = own("half_angle_deg"), own("power")
        return Light(
            position_mm=(
                own("x_mm") * math.cos(angle),
                own("y_mm") * math.sin(angle),
                -own("depth_mm"),
            ),
            direction=(-side * math.cos(ahead), -side * math.sin(ahead), math.cos(tilt)),
            rgb=(power * rgb[0], power * rgb[1], power * rgb[2]),
            size_mm=(0.0 if arc else own("length_mm") or size, size),
            arc_deg=arc,
            lobe=lobe_of_half_angle(half) if half else own("lobe"),
            name=name,
        )


def lobe_of_half_angle(half_angle_deg: float) -> float:
    """Exponent n of the lobe cos^n that has half its axial intensity at that angle."""
    return math.log(0.5) / math.log(math.cos(math.radians(half_angle_deg)))


def _hue(angle_deg: float) -> Triple:
    """Red at 0, green at 120, blue at 240 deg, mixed between."""
    red, green, blue = (
        max(0.0, math.cos(math.radians(angle_deg - at)) + 0.5) / 1.5 for at in (0.0, 120.0, 240.0)
    )
    return red, green, blue
