# SPDX-License-Identifier: Apache-2.0
"""A body of an assembly: solid, names of its faces, colour, material."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from build123d import Face, Solid
from OCP.TopLoc import TopLoc_Location

from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.region_colors import REGION_COLORS, Rgb
from taccel_lab.geometry import Region


@dataclass(frozen=True)
class Part:
    """One body [mm] and what a workshop has to know of it."""

    name: str
    solid: Solid
    face_names: tuple[str, ...]
    """Name of each face, in the order of ``solid.faces()``."""
    color: Rgb
    material: str
    """Material in words, for drawings."""
    face_colors: Mapping[str, Rgb] = field(default_factory=dict)
    """Colours by face name that differ from the part's own."""
    placeholder: bool = False
    """True for a body that only reserves room, such as a bought camera."""

    gel: bool = False
    """True for a layer of the gel, which is cast."""

    @property
    def own_solid(self) -> Solid:
        """The solid in the part's own frame, without the place that joints gave it."""
        return Solid(self.solid.wrapped.Located(TopLoc_Location()))

    @property
    def made_beside(self) -> bool:
        """True for what is made beside the gel: window, housing, cover."""
        return not (self.gel or self.placeholder)

    def __post_init__(self) -> None:
        count = len(self.solid.faces())
        if len(self.face_names) != count:
            raise ValueError(f"{self.name}: {len(self.face_names)} names for {count} faces")

    def faces(self, name: str) -> list[Face]:
        """Faces of one name."""
        pairs = zip(self.solid.faces(), self.face_names, strict=True)
        return [face for face, found in pairs if found == name]

    def face_color(self, name: str) -> Rgb:
        """Colour of the faces of one name."""
        return self.face_colors.get(name, self.color)


def gel_part(gel: LabelledSolid, name: str = "gel_pad") -> Part:
    """The gel as a part; its faces are named and coloured by region."""
    return Part(
        name=name,
        solid=gel.solid,
        face_names=tuple(region.name.lower() for region in gel.regions),
        color=REGION_COLORS[Region.CONTACT],
        material="silicone gel",
        face_colors={region.name.lower(): color for region, color in REGION_COLORS.items()},
        gel=True,
    )
