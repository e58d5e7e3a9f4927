# SPDX-License-Identifier: Apache-2.0
"""Bodies whose faces are known: a solid with a region for each, and a part of an assembly."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from build123d import BoundBox, Face, Solid
from build123d.persistence import deserialize_shape, serialize_shape
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps
from OCP.TopLoc import TopLoc_Location

from taccel_lab.cad.region_colors import REGION_COLORS, Rgb
from taccel_lab.geometry import Region

_VOLUME_TOLERANCE = 1e-6


@dataclass(frozen=True)
class LabelledSolid:
    """A solid in millimetres and what each of its faces is for."""

    solid: Solid
    regions: list[Region]
    """Region of each face, in the order of ``solid.faces()``."""

    def __getstate__(self) -> tuple[bytes | None, list[Region]]:
        """State for another process: the kernel's binary form, exact and with its triangles."""
        return serialize_shape(self.solid.wrapped), self.regions

    def __setstate__(self, state: tuple[bytes, list[Region]]) -> None:
        object.__setattr__(self, "solid", Solid(deserialize_shape(state[0])))
        object.__setattr__(self, "regions", state[1])

    @cached_property
    def box(self) -> BoundBox:
        """What the solid reaches over [mm]; a crowned gel's takes the kernel up to 80 ms."""
        return self.solid.bounding_box()

    @property
    def volume_mm3(self) -> float:
        """Volume [mm^3] to one in a million; ``solid.volume`` is off by up to 0.2 %."""
        found = GProp_GProps()
        BRepGProp.VolumeProperties_s(self.solid.wrapped, found, _VOLUME_TOLERANCE)
        return float(found.Mass())

    def faces(self, region: Region) -> list[Face]:
        """Faces of one region."""
        pairs = zip(self.solid.faces(), self.regions, strict=True)
        return [face for face, found in pairs if found == region]

    def area_mm2(self, region: Region) -> float:
        """Area of one region [mm^2]."""
        return float(sum(face.area for face in self.faces(region)))


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
