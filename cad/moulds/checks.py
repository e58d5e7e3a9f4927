# SPDX-License-Identifier: Apache-2.0
"""The moulds of a gel, one a casting step; whether each closes, holds its volume and lets go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from build123d import Plane, Solid

from taccel_lab.cad.assembly import OVERLAP_MM3
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.moulds.cast_body import is_vertical
from taccel_lab.cad.moulds.two_part import Mould, gel_mould
from taccel_lab.cad.parts.part import LabelledSolid
from taccel_lab.cad.parts.solids import common_volume_mm3
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

_UNDERCUT_SINE = 0.009
"""Sine of half a degree: facets of a vertical curved wall lean by that much."""
_UNDERCUT_MM2 = 0.05
_VOLUME_TOLERANCE = 1e-4


@dataclass(frozen=True)
class MouldReport:
    """Measured figures of a mould; lengths in mm."""

    gel_volume_mm3: float
    """The gel as designed."""
    cavity_volume_mm3: float
    """What the closed mould holds, measured on its two halves."""
    shrinkage_volume_mm3: float
    """What the shrinkage adds to the cavity."""
    draft_volume_mm3: float
    """What the draft adds to the cavity."""
    draft_height_mm: float
    draft_width_mm: float
    """What the draft adds on every side at the parting plane."""
    vertical_mm: float
    """Greatest height of wall left without draft."""
    overlap_mm3: float
    """Common volume of the closed halves."""
    undercut_mm2: float
    """Area of the halves that the gel would catch on."""
    fill_mm3: float
    """Gel to pour, without the holes."""


def check_mould(mould: Mould, gel: LabelledSolid) -> MouldReport:
    """Measure ``mould`` against the gel that it casts; raise InputError when it cannot do so."""
    cavity, lid = mould.cavity.solid, mould.lid.solid
    undercut, where = _undercut(mould)
    if undercut > _UNDERCUT_MM2:
        raise InputError(
            f"{mould.name}: the gel has an undercut of {undercut:.3g} mm^2 at x {where[0]:.2f}, "
            f"y {where[1]:.2f}, z {where[2]:.2f} mm; a mould of two parts cannot let go of it"
        )
    overlap = common_volume_mm3(cavity, lid)
    if overlap > OVERLAP_MM3:
        raise InputError(f"{mould.name}: the closed halves interpenetrate by {overlap:.3g} mm^3")
    held = _held_mm3(mould)
    grown = gel.volume_mm3 / (1 - mould.options.shrinkage_percent / 100) ** 3
    expected = grown + mould.body.draft_volume_mm3
    if abs(held / expected - 1) > _VOLUME_TOLERANCE:
        raise InputError(
            f"{mould.name}: the closed mould holds {held:.3f} mm^3, the gel with its draft has "
            f"{expected:.3f} mm^3"
        )
    insert = 0.0 if mould.insert is None else _volume_mm3(mould.insert)
    return MouldReport(
        gel_volume_mm3=gel.volume_mm3,
        cavity_volume_mm3=held,
        shrinkage_volume_mm3=grown - gel.volume_mm3,
        draft_volume_mm3=mould.body.draft_volume_mm3,
        draft_height_mm=mould.body.draft_height_mm,
        draft_width_mm=mould.body.draft_width_mm,
        vertical_mm=mould.body.vertical_mm,
        overlap_mm3=overlap,
        undercut_mm2=undercut,
        fill_mm3=held - insert,
    )


def _held_mm3(mould: Mould) -> float:
    """Volume between the closed halves above the parting plane, without the gaps at the pins."""
    box = mould.cavity.solid.bounding_box()
    corner = Plane((box.min.X + 0.5, box.min.Y + 0.5, mould.body.base_z_mm))
    block = Solid.make_box(box.size.X - 1, box.size.Y - 1, box.size.Z, corner)
    hollow = block.cut(mould.cavity.solid, mould.lid.solid)
    middle = mould.body.solid.bounding_box().center()
    return _volume_mm3(min(hollow.solids(), key=lambda s: _off(s, middle)))


def _volume_mm3(solid: Solid) -> float:
    return LabelledSolid(solid, []).volume_mm3


def _off(solid: Solid, point: Any) -> float:
    return float((solid.bounding_box().center() - point).length)


def _undercut(mould: Mould) -> tuple[float, np.ndarray]:
    """Area of both halves that faces the wrong way for their pull, and its middle."""
    area, moment = 0.0, np.zeros(3)
    for part, pull in ((mould.cavity, 1.0), (mould.lid, -1.0)):
        solid = part.solid
        # Facets of an upright curved wall lean at random where they are slivers, so that upright
        # faces are left out as a whole.
        labels = [Region.SIDE if is_vertical(f) else Region.CONTACT for f in solid.faces()]
        surface = tessellate_solid(
            LabelledSolid(solid, labels), tolerance_mm=0.02, angle_rad=0.1
        )  # fmt: skip
        corners = surface.vertices_mm[surface.triangles]
        box = solid.bounding_box()
        outer = box.max.Z if pull > 0 else box.min.Z
        on_outer = (np.abs(corners[:, :, 2] - outer) < 1e-4).all(axis=1)
        # A half that moves along +z must not have gel above any of its faces, and so on.
        leans = surface.regions == Region.CONTACT
        wrong = leans & (pull * surface.normals()[:, 2] > _UNDERCUT_SINE) & ~on_outer
        sizes = surface.areas_mm2()[wrong]
        area += float(sizes.sum())
        moment += (corners[wrong].mean(axis=1) * sizes[:, None]).sum(axis=0)
    return area, moment / max(area, 1e-300)


def casting_moulds(
    gel: LabelledSolid,
    layers: Mapping[str, LabelledSolid] | None = None,
    facets_mm: float = 0.0,
) -> list[tuple[Mould, MouldReport]]:
    """Build and check the moulds of ``gel``.

    ``layers`` are its layers by name, core first; two make two moulds: the first casts the core,
    the second the skin round the core, which lies in it on the lid. ``facets_mm`` says how far
    plane facets of ``gel`` lie off the faces that they stand for. Raises InputError when a layer
    cannot be cast.
    """
    names = list(layers or {})
    if len(names) < 2:
        mould = gel_mould(gel, facets_mm=facets_mm)
        return [(mould, check_mould(mould, gel))]
    if len(names) > 2 or layers is None:
        raise InputError(f"moulds cast gels of one or two layers, this one has {len(names)}")
    core, skin = layers[names[0]], layers[names[1]]
    first = gel_mould(core, name=f"mould_1_{names[0]}")
    second = gel_mould(gel, name=f"mould_2_{names[1]}", insert=core, fill=skin)
    return [(first, check_mould(first, core)), (second, check_mould(second, gel))]
