# SPDX-License-Identifier: Apache-2.0
"""Parts that stand together: joined, checked against interpenetration, gaps stated."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from build123d import Color, Compound, Location, RigidJoint, Solid

from taccel_lab.cad.parts.part import Part
from taccel_lab.cad.parts.solids import common_volume_mm3
from taccel_lab.errors import InputError

TOUCHING_MM = 1e-4
"""Parts closer than this touch."""
OVERLAP_MM3 = 1e-3
"""Common volume below which two parts do not interpenetrate (the kernel's noise)."""
_NEAR_MM = 5.0


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
