# SPDX-License-Identifier: Apache-2.0
"""Room for bought parts: the camera module and the LEDs, as boxes.

A placeholder's own frame: origin at the centre of projection or of the emitting face, z along the
line of sight or of the light.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from build123d import Axis, Face, Location, Plane, Solid, Vector

from taccel_lab.cad.parts.part import Part, Rgb
from taccel_lab.profile.optical_design import DesignedCamera, Light

LENS_DIAMETER_MM, LENS_LENGTH_MM = 6.0, 4.0
"""Sizes of a small board camera; the length from the centre of projection back to the board."""
BOARD_MM = (8.0, 8.0, 2.0)
LED_DEPTH_MM = 0.6
LEAST_LED_MM = 0.5
"""Side of an LED that is modelled as a point [mm]."""


def camera_location(camera: DesignedCamera) -> Location:
    """Where the camera stands in the gel frame."""
    turn = camera.gel_from_camera()
    x, z = (tuple(turn[:, k].tolist()) for k in (0, 2))
    return Plane(camera.position_mm, x_dir=x, z_dir=z).location


def led_location(light: Light) -> Location:
    """Where an LED stands in the gel frame: its x lies as near to the xy plane as can be."""
    dx, dy, _ = light.direction
    flat = math.hypot(dx, dy)
    x = (-dy / flat, dx / flat, 0.0) if flat > 1e-9 else (1.0, 0.0, 0.0)
    return Plane(light.position_mm, x_dir=x, z_dir=light.direction).location


def led_names(lights: Sequence[Light]) -> list[str]:
    """A name of its own for each LED, after its light's."""
    names: list[str] = []
    for k, light in enumerate(lights):
        name = f"led_{light.name or k}"
        names.append(f"{name}_{k}" if name in names else name)
    return names


def camera_names(count: int) -> list[str]:
    """A name for each of some cameras: ``camera``, ``camera_2`` and so on."""
    return ["camera" if k == 0 else f"camera_{k + 1}" for k in range(count)]


def camera_part(name: str = "camera", *, spare_mm: float = 0.0) -> Part:
    """The camera placeholder in its own frame, ``spare_mm`` larger on every side but the front."""
    radius, length = LENS_DIAMETER_MM / 2 + spare_mm, LENS_LENGTH_MM
    lens = Solid.make_cylinder(radius, length, Plane((0, 0, -length)))
    x, y, z = (size + 2 * spare_mm for size in BOARD_MM)
    board = Solid.make_box(x, y, z, Plane((-x / 2, -y / 2, -length - z + spare_mm)))
    solid = (lens + board).solids()[0]
    names = tuple("lens_front" if abs(face.center().Z) < 1e-6 else "side" for face in solid.faces())
    return Part(
        name=name,
        solid=solid,
        face_names=names,
        color=(0.16, 0.17, 0.20),
        material="camera module, placeholder",
        face_colors={"lens_front": (0.05, 0.06, 0.12)},
        placeholder=True,
    )


def led_part(light: Light, name: str = "led", *, spare_mm: float = 0.0) -> Part:
    """The placeholder of an LED or a light guide's exit in its own frame, ``spare_mm`` larger on
    every side but the front."""
    x, y = (max(size, LEAST_LED_MM) + 2 * spare_mm for size in light.size_mm)
    depth = LED_DEPTH_MM + spare_mm
    if light.arc_deg:
        solid = _bent_exit(light, y, depth)
    else:
        solid = Solid.make_box(x, y, depth, Plane((-x / 2, -y / 2, -depth)))
    names = tuple("emitting" if face.center().Z > -1e-6 else "side" for face in solid.faces())
    red, green, blue = (value / max(light.rgb) for value in light.rgb)
    color: Rgb = (red, green, blue)
    return Part(
        name=name,
        solid=solid,
        face_names=names,
        color=color,
        material="LED, placeholder",
        placeholder=True,
    )


def _bent_exit(light: Light, height_mm: float, depth_mm: float) -> Solid:
    """The exit's section, behind its face, turned about the gel's z axis; in the light's frame."""
    place, ahead = Vector(*light.position_mm), Vector(*light.direction)
    around = Vector(0, 0, 1).cross(place)
    across = around - ahead * around.dot(ahead)
    middle = Plane(place - ahead * (depth_mm / 2), x_dir=ahead, z_dir=across)
    section = Face.make_rect(depth_mm, height_mm, middle)
    begun = section.rotate(Axis.Z, -light.arc_deg / 2)
    return led_location(light).inverse() * Solid.revolve(begun, light.arc_deg, Axis.Z)
