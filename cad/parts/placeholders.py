# SPDX-License-Identifier: Apache-2.0
"""Room for bought parts: the camera module and the LEDs, as boxes of stated size.

A placeholder's own frame: origin at the centre of projection or of the emitting face, z along the
line of sight or of the light.
"""

from __future__ import annotations

from dataclasses import dataclass

from build123d import Location, Plane, Solid

from taccel_lab.cad.parts.part import Part

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Pose:
    """Where a part stands in the gel frame."""

    position_mm: Triple
    z_axis: Triple
    """Direction of the part's own z, unit length."""
    x_axis: Triple
    """Direction of the part's own x, unit length, square to ``z_axis``."""

    def location(self) -> Location:
        """The pose as build123d states it."""
        return Plane(self.position_mm, x_dir=self.x_axis, z_dir=self.z_axis).location


@dataclass(frozen=True)
class CameraShape:
    """Room for a camera module [mm]; the defaults are those of a small board camera."""

    pose: Pose
    lens_diameter_mm: float = 6.0
    lens_length_mm: float = 4.0
    """From the centre of projection back to the board."""
    board_mm: Triple = (8.0, 8.0, 2.0)


@dataclass(frozen=True)
class LedShape:
    """Room for one LED [mm]."""

    pose: Pose
    name: str
    size_mm: tuple[float, float] = (1.0, 1.0)
    """Width and height of the emitting face."""
    depth_mm: float = 0.6
    color: Triple = (0.9, 0.9, 0.9)


def camera_part(shape: CameraShape, *, spare_mm: float = 0.0) -> Part:
    """The camera placeholder in its own frame, ``spare_mm`` larger on every side but the front."""
    radius, length = shape.lens_diameter_mm / 2 + spare_mm, shape.lens_length_mm
    lens = Solid.make_cylinder(radius, length, Plane((0, 0, -length)))
    x, y, z = (size + 2 * spare_mm for size in shape.board_mm)
    board = Solid.make_box(x, y, z, Plane((-x / 2, -y / 2, -length - z + spare_mm)))
    solid = (lens + board).solids()[0]
    names = tuple("lens_front" if abs(face.center().Z) < 1e-6 else "side" for face in solid.faces())
    return Part(
        name="camera",
        solid=solid,
        face_names=names,
        color=(0.16, 0.17, 0.20),
        material="camera module, placeholder",
        face_colors={"lens_front": (0.05, 0.06, 0.12)},
        placeholder=True,
    )


def led_part(shape: LedShape, *, spare_mm: float = 0.0) -> Part:
    """The LED placeholder in its own frame, ``spare_mm`` larger on every side but the front."""
    x, y = (size + 2 * spare_mm for size in shape.size_mm)
    depth = shape.depth_mm + spare_mm
    solid = Solid.make_box(x, y, depth, Plane((-x / 2, -y / 2, -depth)))
    names = tuple("emitting" if face.center().Z > -1e-6 else "side" for face in solid.faces())
    return Part(
        name=shape.name,
        solid=solid,
        face_names=names,
        color=shape.color,
        material="LED, placeholder",
        placeholder=True,
    )
