# SPDX-License-Identifier: Apache-2.0
"""A two-part mould: the cavity shapes the contact face, the lid closes the gel's back.

The parting plane is where the gel is glued. The cavity is released along +z (out of the gel); what
shapes the inside of a hollow gel is a core on the lid, released along -z.
"""

from __future__ import annotations

from dataclasses import dataclass

from build123d import Face, Plane, ShapeList, Solid
from build123d.topology import Shape

from taccel_lab.cad.moulds.cast_body import CastBody, cast_body
from taccel_lab.cad.moulds.gates import Gate, place_gates
from taccel_lab.cad.moulds.options import MouldOptions
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.outline import prism, rounded_rectangle
from taccel_lab.cad.parts.part import Part
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

_ON_PLANE_MM = 1e-4
_PIN_TIP_MM = 0.5
_PIN_HOLE_SPARE_MM = 0.5
_CORNER_MM = 2.0
_MATERIAL = "resin print or aluminium; polish what shapes contact face and window"


@dataclass(frozen=True)
class Mould:
    """Cavity and lid for one casting step, closed, in the gel frame (scaled by the shrinkage)."""

    name: str
    cavity: Part
    lid: Part
    body: CastBody
    gates: tuple[Gate, ...]
    options: MouldOptions
    insert: Solid | None = None
    """What was cast before and lies in the mould: the core under a skin."""

    @property
    def parts(self) -> tuple[Part, Part]:
        """Cavity and lid."""
        return self.cavity, self.lid


def gel_mould(
    gel: LabelledSolid,
    options: MouldOptions | None = None,
    *,
    name: str = "mould",
    insert: LabelledSolid | None = None,
    fill: LabelledSolid | None = None,
) -> Mould:
    """The mould that casts ``gel`` (the gel frame).

    For a skin, ``gel`` is the whole body, ``insert`` the core that was cast before and ``fill`` the
    skin alone, over whose back the holes then lie.

    Raises InputError when the gel cannot be cast in two parts, with the reason.
    """
    options = options or MouldOptions()
    body = cast_body(
        gel.solid, draft_deg=options.draft_deg, shrinkage_percent=options.shrinkage_percent
    )
    scale = 1 / (1 - options.shrinkage_percent / 100)
    box = body.solid.bounding_box()
    size = (box.size.X + 2 * options.wall_mm, box.size.Y + 2 * options.wall_mm)
    center = (box.center().X, box.center().Y)
    base = body.base_z_mm
    plan = rounded_rectangle(size, _CORNER_MM, base, center)
    block = prism(plan, box.max.Z - base + options.wall_mm)
    pieces = sorted(block.cut(body.solid).solids(), key=lambda s: s.bounding_box().size.X)
    cavity, cores = pieces[-1], pieces[:-1]
    if cavity.bounding_box().size.X < size[0] - _ON_PLANE_MM:
        raise InputError("the cavity of the mould breaks through its block")
    lid = prism(plan, -options.lid_mm)
    for core in cores:
        lid = _single(lid + core, "lid with its core")
    gates = place_gates(
        _gate_faces(fill or gel, scale), pour_mm=options.pour_mm, vent_mm=options.vent_mm,
        vents=options.vents,
    )  # fmt: skip
    for gate in gates:
        hole = Solid.make_cylinder(
            gate.diameter_mm / 2, options.lid_mm, Plane((*gate.at_mm, base - options.lid_mm))
        )
        lid = _single(lid.cut(hole), "lid with its holes")
    cavity, lid = _with_pins(cavity, lid, size, center, base, box.max.Z - base, options)
    return Mould(
        name=name,
        cavity=_part(f"{name}_cavity", cavity, body, (0.55, 0.62, 0.70)),
        lid=_part(f"{name}_lid", lid, body, (0.80, 0.72, 0.55)),
        body=body,
        gates=gates,
        options=options,
        insert=None if insert is None else insert.solid.scale(scale),
    )


def _gate_faces(gel: LabelledSolid, scale: float) -> list[Face]:
    """The lowest horizontal faces beside the window, or all when the window is everything."""
    low = gel.solid.bounding_box().min.Z
    pairs = list(zip(gel.solid.faces(), gel.regions, strict=True))
    flat = [(f, r) for f, r in pairs if f.bounding_box().max.Z < low + _ON_PLANE_MM]
    beside = [face for face, region in flat if region != Region.WINDOW]
    return [face.scale(scale) for face in (beside or [face for face, _ in flat])]


def _with_pins(
    cavity: Solid,
    lid: Solid,
    size: tuple[float, float],
    center: tuple[float, float],
    base: float,
    depth: float,
    options: MouldOptions,
) -> tuple[Solid, Solid]:
    """Two pins of unequal thickness on the lid, in opposite corners, and their holes."""
    inset = max(options.wall_mm / 2, options.pin_mm / 2 + 1)
    if 2 * inset > options.wall_mm + 1e-9:
        raise InputError(
            f"pin_mm = {options.pin_mm:g} does not fit beside the cavity in wall_mm = "
            f"{options.wall_mm:g}; allowed: up to {options.wall_mm - 2:g} mm"
        )
    length = min(options.pin_mm * 1.5, depth + options.wall_mm - _PIN_HOLE_SPARE_MM - 1)
    for sign, diameter in ((1, options.pin_mm), (-1, options.pin_mm - 1)):
        x, y = (c + sign * (s / 2 - inset) for c, s in zip(center, size, strict=True))
        radius = diameter / 2
        shaft = Solid.make_cylinder(radius, length - _PIN_TIP_MM, Plane((x, y, base)))
        tip = Solid.make_cone(
            radius,
            radius - _PIN_TIP_MM / 2,
            _PIN_TIP_MM,
            Plane((x, y, base + length - _PIN_TIP_MM)),
        )
        lid = _single(lid + shaft + tip, "lid with its pins")
        hole = Solid.make_cylinder(
            radius + options.pin_clearance_mm, length + _PIN_HOLE_SPARE_MM, Plane((x, y, base))
        )
        cavity = _single(cavity.cut(hole), "cavity with its pin holes")
    return cavity, lid


def _part(name: str, solid: Solid, body: CastBody, color: tuple[float, float, float]) -> Part:
    """Faces that shape the gel are "mould", those of the parting plane "parting"."""
    names = []
    for face in solid.faces():
        box = face.bounding_box()
        point = face.position_at(0.5, 0.5)
        if box.size.Z < _ON_PLANE_MM and abs(box.min.Z - body.base_z_mm) < _ON_PLANE_MM:
            names.append("parting")
        elif body.solid.distance_to(point) < _ON_PLANE_MM:
            names.append("mould")
        else:
            names.append("side")
    return Part(
        name=name,
        solid=solid,
        face_names=tuple(names),
        color=color,
        material=_MATERIAL,
        face_colors={"mould": (0.90, 0.55, 0.20)},
    )


def _single(shape: Shape | ShapeList | None, what: str) -> Solid:
    solids = shape.solids() if shape is not None else []
    if len(solids) != 1 or not solids[0].is_valid:
        raise InputError(
            f"the CAD kernel cannot build the {what}: {len(solids)} bodies, one valid one is "
            "needed; change wall_mm, lid_mm or pin_mm a little"
        )
    return solids[0]
