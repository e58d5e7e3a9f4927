# SPDX-License-Identifier: Apache-2.0
"""The housing: a box with the window's seat in front and a cover behind, in the gel frame.

Front to back: a pocket that takes window and gel with clearance, the seat (a ledge on which the
window's back rests) round an opening to look through, the hollow with screw bosses in its corners,
and the cover, with an aperture for each camera and holes over the bosses.
"""

from __future__ import annotations

from dataclasses import dataclass

from build123d import Axis, BoundBox, Face, Location, Plane, Pos, ShapeList, Solid, Vector, Wire
from build123d.topology import Shape

from taccel_lab.cad.parts.housing_shape import CLEARANCE_MM, LEAST_RIM_MM, RIM_MM, HousingShape
from taccel_lab.cad.parts.part import Part
from taccel_lab.cad.parts.placeholders import (
    BOARD_MM,
    LENS_LENGTH_MM,
    camera_location,
    camera_part,
    led_location,
    led_part,
)
from taccel_lab.cad.parts.solids import common_volume_mm3, grown, prism, rounded_rectangle
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import DesignedCamera, Light

_COLOR = (0.30, 0.32, 0.35)
_COVER_COLOR = (0.22, 0.23, 0.26)
_BOSSES_MM = ((5.0, 2.1), (4.0, 1.6), (3.2, 1.2))
"""Diameters of screw bosses and their pilot holes, for self-tapping M2.5, M2 and M1.6 screws."""
_BOSS_HEIGHT_MM = 6.0
_MATERIAL = "black plastic, matt inside"


@dataclass(frozen=True)
class GelSeat:
    """What the housing has to hold [mm]."""

    z_mm: float
    """z of the ledge, on which the lowest plane of the window (or of the gel) rests."""
    outlines: tuple[tuple[Wire, float], ...]
    """Plane outlines of window and gel in the gel frame, and the z above which each needs room."""
    ledge_outline: Wire
    """Outline of what rests on the ledge."""
    ledge_mm: float
    """Width of the ledge."""


@dataclass(frozen=True)
class HousingParts:
    """Housing and cover, and what could not be fitted."""

    housing: Part
    cover: Part
    notes: tuple[str, ...]


def housing_parts(
    shape: HousingShape,
    seat: GelSeat,
    cameras: tuple[DesignedCamera, ...] = (),
    leds: tuple[Light, ...] = (),
) -> HousingParts:
    """Build housing and cover in the gel frame; raises InputError naming the bound that is broken.

    Faces of the housing: "front", "seat", "pocket" and "side"; of the cover: "back" and "side".
    """
    _check(shape, seat)
    x, y, z = shape.size_mm
    wall, back = shape.wall_mm, shape.back_z_mm
    outside = rounded_rectangle((x, y), shape.corner_radius_mm, shape.front_z_mm, shape.offset_mm)
    body = prism(outside, -(z - wall))
    deeper: Face | None = None
    for outline, floor in sorted(seat.outlines, key=lambda pair: pair[1]):
        room = grown(outline, CLEARANCE_MM, floor)
        # Coincident walls of two pockets confuse the kernel, so an outline that fits the deeper
        # pocket is not cut again.
        if shape.front_z_mm - floor <= 1e-9 or (deeper is not None and _within(room, deeper)):
            continue
        deeper = room
        body = _one(body - prism(room, shape.front_z_mm - floor + 1))
    inner = rounded_rectangle(
        (x - 2 * wall, y - 2 * wall), max(shape.corner_radius_mm - wall, 0.3), back, shape.offset_mm
    )
    hollow = prism(inner, seat.z_mm - wall - back)
    opening = prism(grown(seat.ledge_outline, -seat.ledge_mm, back), seat.z_mm - back)
    body = _one(body - hollow - (opening & prism(inner, seat.z_mm - back)))
    cover = prism(
        rounded_rectangle((x, y), shape.corner_radius_mm, back, shape.offset_mm), shape.wall_mm
    )
    body, cover, bosses = _with_bosses(shape, seat, body, cover, cameras, leds)
    notes = () if bosses else ("no room for screw bosses: glue or clip the cover",)
    for room in _bought_parts_room(shape, cameras, leds):
        body, cover = _one(body - room), _one(cover - room)
    housing = Part(
        name="housing",
        solid=body,
        face_names=tuple(_housing_face(shape, seat, face) for face in body.faces()),
        color=_COLOR,
        material=_MATERIAL,
        face_colors={"seat": (0.55, 0.56, 0.60)},
    )
    lid = Part(
        name="cover",
        solid=cover,
        face_names=tuple(
            "back" if abs(face.bounding_box().max.Z - back) < 1e-6 else "side"
            for face in cover.faces()
        ),
        color=_COVER_COLOR,
        material=_MATERIAL,
    )
    return HousingParts(housing, lid, notes)


def _check(shape: HousingShape, seat: GelSeat) -> None:
    x, y, z = shape.size_mm
    if not (0.3 <= shape.wall_mm and 2 * shape.wall_mm < min(x, y)):
        raise InputError(
            f"housing_wall_mm = {shape.wall_mm:g} is not allowed; use 0.3 to {min(x, y) / 2:g} mm"
        )
    if shape.front_z_mm < seat.z_mm - 1e-9:
        raise InputError(
            f"housing_front_mm = {-shape.front_z_mm:g} lies behind the seat of the window, "
            f"{-seat.z_mm:g} mm behind the apex, so that nothing holds it; allowed: up to "
            f"{-seat.z_mm:g} mm"
        )
    depth = shape.front_z_mm - seat.z_mm + 2 * shape.wall_mm
    if z < depth + 1:
        raise InputError(
            f"housing_z_mm = {z:g} leaves no hollow behind the window; allowed: at least "
            f"{depth + 1:.2f} mm"
        )
    for outline, floor in seat.outlines:
        if shape.front_z_mm - floor <= 1e-9:
            continue
        box = outline.bounding_box()
        for axis, size, offset, low, high in (
            ("x", x, shape.offset_mm[0], box.min.X, box.max.X),
            ("y", y, shape.offset_mm[1], box.min.Y, box.max.Y),
        ):
            least = 2 * (max(high - offset, offset - low) + RIM_MM)
            if size < least - 1e-9:
                raise InputError(
                    f"housing_{axis}_mm = {size:g} is too small for what it holds; allowed: "
                    f"at least {least:.2f} mm (a rim of {LEAST_RIM_MM:g} mm)"
                )


def _with_bosses(
    shape: HousingShape,
    seat: GelSeat,
    body: Solid,
    cover: Solid,
    cameras: tuple[DesignedCamera, ...],
    leds: tuple[Light, ...],
) -> tuple[Solid, Solid, int]:
    """Posts in the corners of the hollow, the largest that block neither light nor view."""
    x, y, _ = shape.size_mm
    floor = shape.back_z_mm + shape.wall_mm
    height = min(_BOSS_HEIGHT_MM, seat.z_mm - shape.wall_mm - floor)
    keep = [grown(seat.ledge_outline, -seat.ledge_mm, 0.0)]
    rooms = _bought_parts_room(shape, cameras, leds)
    for diameter, pilot in _BOSSES_MM:
        reach = [size / 2 - shape.wall_mm - 0.4 * diameter for size in (x, y)]
        centers = [
            (shape.offset_mm[0] + sx * reach[0], shape.offset_mm[1] + sy * reach[1])
            for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        posts = [Solid.make_cylinder(diameter / 2, height, Plane((*c, floor))) for c in centers]
        feet = [post.faces().sort_by(Axis.Z)[0] for post in posts]
        blocked = any(
            (Pos(0, 0, -foot.center().Z) * foot).distance_to(area) < 1e-6
            for foot in feet
            for area in keep
        ) or any(common_volume_mm3(post, room) > 1e-6 for post in posts for room in rooms)
        if blocked or height < 2:
            continue
        outer = prism(
            rounded_rectangle((x, y), shape.corner_radius_mm, floor, shape.offset_mm), height
        )
        for post, center in zip(posts, centers, strict=True):
            body = _one(body + (post & outer))
            hole = Solid.make_cylinder(pilot / 2, 0.85 * height, Plane((*center, floor)))
            body = _one(body - hole)
            through = Solid.make_cylinder(
                0.62 * pilot, shape.wall_mm, Plane((*center, shape.back_z_mm))
            )
            cover = _one(cover - through)
        return body, cover, len(centers)
    return body, cover, 0


def _bought_parts_room(
    shape: HousingShape, cameras: tuple[DesignedCamera, ...], leds: tuple[Light, ...]
) -> list[Solid]:
    """What cameras and LEDs need, the cameras also their way in from behind."""
    spare = CLEARANCE_MM
    rooms = [led_location(led) * led_part(led, spare_mm=spare).solid for led in leds]
    for camera in cameras:
        solid = camera_part(spare_mm=spare).solid
        board = [size + 2 * spare for size in BOARD_MM[:2]]
        corner = Plane((-board[0] / 2, -board[1] / 2, 0))
        entry = Solid.make_box(board[0], board[1], 4 * shape.size_mm[2], corner)
        behind = Location((0, 0, -LENS_LENGTH_MM - 4 * shape.size_mm[2]))
        rooms.append(camera_location(camera) * (solid + behind * entry).solids()[0])
    return rooms


def _housing_face(shape: HousingShape, seat: GelSeat, face: Face) -> str:
    box = face.bounding_box()
    if box.min.Z > shape.front_z_mm - 1e-6:
        return "front"
    if box.max.Z - box.min.Z < 1e-6 and abs(box.max.Z - seat.z_mm) < 1e-6:
        return "seat"
    if box.min.Z > seat.z_mm - 1e-6 and _inside(shape, box):
        return "pocket"
    return "side"


def _inside(shape: HousingShape, box: BoundBox) -> bool:
    x, y, _ = shape.size_mm
    cx, cy = shape.offset_mm
    return (
        box.max.X < cx + x / 2 - 1e-6
        and box.min.X > cx - x / 2 + 1e-6
        and box.max.Y < cy + y / 2 - 1e-6
        and box.min.Y > cy - y / 2 + 1e-6
    )


def _within(inner: Face, outer: Face) -> bool:
    """Whether the outline of one area stays within another in plan, or on its edge."""
    lift = Vector(0, 0, outer.center().Z - inner.center().Z)
    wire = inner.outer_wire()
    points = [wire.position_at(i / 64) + lift for i in range(64)]
    return all(outer.is_inside(p, 1e-3) or outer.distance_to(p) < 1e-3 for p in points)


def _one(shape: Shape | ShapeList) -> Solid:
    solids = shape.solids()
    if len(solids) != 1:
        raise InputError(
            f"the housing falls into {len(solids)} pieces; make it larger or its wall thicker"
        )
    if not solids[0].is_valid:
        raise InputError(
            "the CAD kernel built an invalid housing; change housing_x_mm, housing_wall_mm or "
            "housing_corner_mm a little"
        )
    return solids[0]
