# SPDX-License-Identifier: Apache-2.0
"""Parts that stand together: joined, checked against interpenetration, gaps stated.

Those of a sensor: gel on its window, window in the housing's seat, cameras and LEDs.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from build123d import Color, Compound, Location, RigidJoint, Solid, Wire

from taccel_lab.cad.parts.housing import GelSeat, HousingParts, housing_parts
from taccel_lab.cad.parts.housing_shape import HousingShape
from taccel_lab.cad.parts.part import Part
from taccel_lab.cad.parts.placeholders import (
    camera_location,
    camera_names,
    camera_part,
    led_location,
    led_names,
    led_part,
)
from taccel_lab.cad.parts.solids import base_outline, common_volume_mm3
from taccel_lab.cad.parts.window import window_part
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import DesignedCamera, Light, Window

TOUCHING_MM = 1e-4
"""Parts closer than this touch."""
OVERLAP_MM3 = 1e-3
"""Common volume below which two parts do not interpenetrate (the kernel's noise)."""
_NEAR_MM = 5.0
_LEDGE_MM, _LEAST_LEDGE_MM = 1.0, 0.3


@dataclass(frozen=True)
class PartClearance:
    """How two parts of an assembly stand to each other."""

    first: str
    second: str
    gap_mm: float
    """Least distance [mm]; 0 when they touch or interpenetrate."""
    overlap_mm3: float
    """Common volume [mm^3]."""
    placeholder: bool
    """True when one of the two only reserves room."""


@dataclass(frozen=True)
class Assembly:
    """Parts in their places, in the gel frame."""

    name: str
    parts: tuple[Part, ...]
    notes: tuple[str, ...] = ()
    """What was left out, in words."""

    def part(self, name: str) -> Part:
        """The part of one name."""
        for part in self.parts:
            if part.name == name:
                return part
        raise KeyError(f"no part {name!r}; there are {', '.join(p.name for p in self.parts)}")

    def compound(self) -> Compound:
        """The assembly as build123d keeps it, a labelled and coloured child for each part."""
        children = []
        for part in self.parts:
            child = part.solid
            child.label, child.color = part.name, Color(*part.color)
            children.append(child)
        return Compound(label=self.name, children=children)

    def clearances(self) -> list[PartClearance]:
        """Gap and common volume of every two parts that come within 5 mm of each other."""
        found = []
        for first, second in combinations(self.parts, 2):
            if _boxes_apart_mm(first.solid, second.solid) > _NEAR_MM:
                continue
            gap = first.solid.distance_to(second.solid)
            if gap > _NEAR_MM:
                continue
            overlap = 0.0 if gap > TOUCHING_MM else common_volume_mm3(first.solid, second.solid)
            found.append(
                PartClearance(
                    first=first.name,
                    second=second.name,
                    gap_mm=gap if gap > TOUCHING_MM else 0.0,
                    overlap_mm3=overlap,
                    placeholder=first.placeholder or second.placeholder,
                )
            )
        return found

    def to_json(self, clearances: Sequence[PartClearance] | None = None) -> dict[str, Any]:
        """Parts, joints and clearances (measured unless given) as plain values."""
        found = self.clearances() if clearances is None else clearances
        return {
            "name": self.name,
            "parts": {
                part.name: {
                    "material": part.material,
                    "volume_mm3": part.solid.volume,
                    "position_mm": list(part.solid.location.position),
                    "joints": sorted(part.solid.joints),
                    "placeholder": part.placeholder,
                }
                for part in self.parts
            },
            "clearances": [dataclasses.asdict(clearance) for clearance in found],
            "notes": list(self.notes),
        }


def overlapping(clearances: Sequence[PartClearance]) -> list[PartClearance]:
    """Pairs that interpenetrate by more than the kernel's noise."""
    return [c for c in clearances if c.overlap_mm3 > OVERLAP_MM3]


def require_no_overlap(clearances: Sequence[PartClearance]) -> list[str]:
    """Raise InputError when made parts interpenetrate; say in words which placeholders do.

    The size of a placeholder is an assumption, so that its overlaps are a warning only.
    """
    bad = overlapping(clearances)
    made = [c for c in bad if not c.placeholder]
    if made:
        words = ", ".join(f"{c.first} and {c.second} by {c.overlap_mm3:.3g} mm^3" for c in made)
        raise InputError(f"parts of the assembly interpenetrate: {words}")
    return [
        f"{c.first} and {c.second} interpenetrate by {c.overlap_mm3:.3g} mm^3 (room for a bought "
        "part, of assumed size)"
        for c in bad
    ]


def joint(solid: Solid, name: str, at: Location | None = None) -> RigidJoint:
    """A named rigid joint of ``solid`` at a place in its own frame."""
    return RigidJoint(name, to_part=solid, joint_location=at or Location())


def _boxes_apart_mm(first: Solid, second: Solid) -> float:
    """Distance of the bounding boxes along the axis that parts them most [mm]."""
    a, b = first.bounding_box(), second.bounding_box()
    gaps = [
        max(low_a - high_b, low_b - high_a)
        for low_a, high_a, low_b, high_b in zip(a.min, a.max, b.min, b.max, strict=True)
    ]
    return max(*gaps, 0.0)


def sensor_assembly(
    name: str,
    gel: tuple[Part, ...],
    thickness_mm: float,
    *,
    window: Window | None = None,
    housing: HousingShape | None = None,
    cameras: tuple[DesignedCamera, ...] = (),
    leds: tuple[Light, ...] = (),
    view_mm: tuple[float, float] = (0.0, 0.0),
) -> Assembly:
    """Join the parts of a sensor, in the gel frame.

    ``gel`` are the gel's layers, core first, as modelled in the gel frame; ``thickness_mm`` lies
    between its apex and what it is glued to. The window's joint "bond" meets the gel's "back", the
    window's "seat" the housing's, cameras and LEDs sit on joints of the housing (of the gel when
    there is none). ``view_mm`` is what the cameras see: a separate face on a plate's front, and
    what the seat must leave open.
    """
    layers = tuple(_own_copy(part) for part in gel)
    back = joint(layers[0].solid, "back", Location((0, 0, -thickness_mm)))
    for layer in layers[1:]:
        joint(layers[0].solid, f"under_{layer.name}").connect_to(joint(layer.solid, "inside"))
    parts: list[Part] = list(layers)
    notes: list[str] = []
    lowest = min(layer.solid.bounding_box().min.Z for layer in layers)
    outline = base_outline(min(layers, key=lambda part: part.solid.bounding_box().min.Z).solid)
    if len(layers) > 1:
        outline = max((base_outline(part.solid) for part in layers), key=lambda w: w.length)
    pane = None
    if window is not None:
        pane = window_part(window, outline, view_mm)
        back.connect_to(joint(pane.solid, "bond"))
        parts.append(pane)
    holder = parts[0].solid
    if housing is not None:
        made = _housed(housing, layers, outline, lowest, pane, window, view_mm, cameras, leds)
        parts += [made.housing, made.cover]
        notes += made.notes
        holder = made.housing.solid
        joint(holder, "cover").connect_to(joint(made.cover.solid, "cover"))
    for camera, camera_name in zip(cameras, camera_names(len(cameras)), strict=True):
        body, at = camera_part(camera_name), camera_location(camera)
        joint(holder, camera_name, at).connect_to(joint(body.solid, "projection"))
        parts.append(body)
    for led, led_name in zip(leds, led_names(leds), strict=True):
        body = led_part(led, led_name)
        joint(holder, led_name, led_location(led)).connect_to(joint(body.solid, "emitter"))
        parts.append(body)
    return Assembly(name, tuple(parts), tuple(notes))


def _own_copy(part: Part) -> Part:
    """The part with a copied solid, so that joints do not depend on the caller's."""
    return dataclasses.replace(part, solid=copy.copy(part.solid))


def _housed(
    shape: HousingShape,
    layers: tuple[Part, ...],
    outline: Wire,
    lowest: float,
    pane: Part | None,
    window: Window | None,
    view_mm: tuple[float, float],
    cameras: tuple[DesignedCamera, ...],
    leds: tuple[Light, ...],
) -> HousingParts:
    """Housing and cover made for gel and window, joined seat to seat."""
    resting, outlines, ledge_on = lowest, [(outline, lowest)], outline
    if pane is not None and window is not None:
        seated = pane.solid.bounding_box()
        resting = min(seated.min.Z, lowest)
        ledge_on = base_outline(pane.solid)
        outlines.append((ledge_on, seated.min.Z))
    if window is not None and window.shape == "dome":
        # The camera looks into a dome through its opening, the ring that it stands on is free.
        ledge = min(_LEDGE_MM, 0.9 * window.thickness_mm)
    else:
        ledge = _ledge_mm(ledge_on, view_mm)
    made = housing_parts(
        shape, GelSeat(resting, tuple(outlines), ledge_on, ledge), cameras, leds
    )  # fmt: skip
    seat = joint(made.housing.solid, "seat", Location((0, 0, resting)))
    if pane is None:
        seat.connect_to(joint(layers[0].solid, "seat", Location((0, 0, resting))))
    else:
        # Window before gel, so that a gel always follows what it is glued to.
        at = Location((0, 0, resting))
        seat.connect_to(joint(pane.solid, "seat", at))
        pane.solid.joints["bond"].connect_to(layers[0].solid.joints["back"])
        for layer in layers[1:]:
            layers[0].solid.joints[f"under_{layer.name}"].connect_to(layer.solid.joints["inside"])
    return made


def _ledge_mm(outline: Wire, view_mm: tuple[float, float]) -> float:
    """Width of the ledge: as wanted, but clear of the camera's view."""
    size = outline.bounding_box().size
    room = min((size.X - view_mm[0]) / 2, (size.Y - view_mm[1]) / 2)
    if room < _LEAST_LEDGE_MM:
        raise InputError(
            f"the window of {size.X:.2f} x {size.Y:.2f} mm leaves a ledge of {room:.2f} mm beside "
            f"the camera's view of {view_mm[0]:.2f} x {view_mm[1]:.2f} mm; allowed: at least "
            f"{_LEAST_LEDGE_MM} mm"
        )
    return min(_LEDGE_MM, room)
