# SPDX-License-Identifier: Apache-2.0
"""A two-part mould: the cavity shapes the contact face, the lid closes the gel's back.

The parting plane is where the gel is glued. The cavity is released along +z (out of the gel); what
shapes the inside of a hollow gel is a core on the lid, released along -z.

Gel is poured in and air gets out through holes in the lid, over the gel's back. They leave a mark,
so that they keep to the faces given, such as the bonded margin beside the window. The pour hole
goes where there is most room, the vents as far from it and from each other as can be, because air
that is pushed ahead of the gel collects there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from build123d import Face, GeomType, Plane, ShapeList, Solid
from build123d.topology import Shape

from taccel_lab.cad.moulds.cast_body import CastBody, cast_body
from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.cad.parts.part import LabelledSolid, Part
from taccel_lab.cad.parts.solids import FacesNear, prism, rounded_rectangle
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

_PRACTICE = "common practice for silicone cast in printed or milled moulds"
_ON_PLANE_MM = 1e-4
_PIN_TIP_MM = 0.5
_PIN_HOLE_SPARE_MM = 0.5
_CORNER_MM = 2.0
_MATERIAL = "resin print or aluminium; polish what shapes contact face and window"
_RIM_MM = 0.1
"""Least distance of a hole from the edge of its face."""
_LEAST_DIAMETER_MM = 0.5
_GRID = 120
_EDGE_POINTS = 48


@dataclass(frozen=True)
class MouldOptions(ParameterSet):
    """Dimensions of a two-part mould."""

    draft_deg: float = parameter(
        2.0, minimum=0, maximum=10, unit="deg", source=_PRACTICE,
        description="angle by which vertical walls open towards the parting plane",
    )  # fmt: skip
    shrinkage_percent: float = parameter(
        0.1, minimum=0, maximum=5, unit="%",
        source="data sheets of platinum-cured silicones: under 0.1 %; condensation-cured up to 1 %",
        description="linear shrinkage of the gel while it cures; the cavity is that much larger",
    )  # fmt: skip
    wall_mm: float = parameter(
        9.0, minimum=5, maximum=50, unit="mm", source=_PRACTICE,
        description="mould material beside and above the cavity",
    )  # fmt: skip
    lid_mm: float = parameter(
        6.0, minimum=2, maximum=30, unit="mm", source=_PRACTICE,
        description="thickness of the lid",
    )  # fmt: skip
    pin_mm: float = parameter(
        4.0, minimum=2, maximum=10, unit="mm", source=_PRACTICE,
        description="diameter of the thicker registration pin; the other is 1 mm thinner, so that "
        "the lid fits one way round only",
    )  # fmt: skip
    pin_clearance_mm: float = parameter(
        0.1, minimum=0.02, maximum=0.5, unit="mm", source=_PRACTICE,
        description="radial gap between pins and holes",
    )  # fmt: skip
    pour_mm: float = parameter(
        3.0, minimum=0.6, maximum=10, unit="mm", source=_PRACTICE,
        description="diameter of the pour hole, where the gel's back leaves room for it",
    )  # fmt: skip
    vent_mm: float = parameter(
        1.0, minimum=0.4, maximum=3, unit="mm", source=_PRACTICE,
        description="diameter of the vents, where the gel's back leaves room for them",
    )  # fmt: skip
    vents: int = parameter(3, minimum=1, maximum=8, source=_PRACTICE, description="number of vents")


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
    facets_mm: float = 0.0,
) -> Mould:
    """The mould that casts ``gel`` (the gel frame).

    For a skin, ``gel`` is the whole body, ``insert`` the core that was cast before and ``fill`` the
    skin alone, over whose back the holes then lie. ``facets_mm`` is that of ``cast_body``.

    Raises InputError when the gel cannot be cast in two parts, with the reason.
    """
    options = options or MouldOptions()
    body = cast_body(
        gel.solid,
        draft_deg=options.draft_deg,
        shrinkage_percent=options.shrinkage_percent,
        facets_mm=facets_mm,
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
    beside = f"does not fit beside the cavity in wall_mm = {options.wall_mm:g}"
    options.require("pin_mm", beside, high=options.wall_mm - 2 + 1e-9)
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
    gel = FacesNear(body.solid)
    for face in solid.faces():
        box = face.bounding_box()
        if box.size.Z < _ON_PLANE_MM and abs(box.min.Z - body.base_z_mm) < _ON_PLANE_MM:
            names.append("parting")
        # Not by a point of the face: the middle of its parameters may lie beside a triangle. One
        # edge is not enough: holes for pouring end on the gel.
        elif all(gel.touch(edge.position_at(0.5), _ON_PLANE_MM) for edge in face.edges()):
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


@dataclass(frozen=True)
class Gate:
    """One vertical hole through the lid."""

    kind: str
    """"pour" or "vent"."""
    at_mm: tuple[float, float]
    diameter_mm: float


def place_gates(
    faces: Sequence[Face], *, pour_mm: float, vent_mm: float, vents: int
) -> tuple[Gate, ...]:
    """Pour hole and vents over horizontal ``faces``, as large as wanted or as there is room for.

    Raises InputError when not even holes of 0.5 mm fit.
    """
    starts, ends = _segments(faces)
    points, room = _places(starts, ends)
    best = 2 * (float(room.max(initial=0)) - _RIM_MM)
    if best < _LEAST_DIAMETER_MM:
        raise InputError(
            f"the back of the gel leaves room for a pour hole of {max(best, 0):.2f} mm only; "
            f"allowed: at least {_LEAST_DIAMETER_MM} mm. Make the margin round the window wider"
        )
    # Of equally roomy places the rightmost, so that the choice does not depend on rounding.
    pour = int((room.round(2) * 1e6 + points[:, 0]).argmax())
    gates = [Gate("pour", _xy(points[pour]), min(pour_mm, best))]
    vent = min(vent_mm, max(0.6 * best, _LEAST_DIAMETER_MM))
    open_to = np.flatnonzero(room >= vent / 2 + _RIM_MM)
    distance = np.linalg.norm(points[open_to] - points[pour], axis=1)
    for _ in range(vents):
        farthest = int(distance.argmax())
        if distance[farthest] < pour_mm + vent:
            break
        place = points[open_to[farthest]]
        gates.append(Gate("vent", _xy(place), vent))
        distance = np.minimum(distance, np.linalg.norm(points[open_to] - place, axis=1))
    if len(gates) == 1:
        raise InputError("the back of the gel leaves no room for a vent beside the pour hole")
    return tuple(gates)


def _xy(point: np.ndarray) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _segments(faces: Sequence[Face]) -> tuple[np.ndarray, np.ndarray]:
    """Straight pieces of all edges of the faces in plan, shape [n, 2] twice."""
    chains = []
    for face in faces:
        for edge in face.edges():
            straight = edge.geom_type == GeomType.LINE
            t = np.linspace(0, 1, 2 if straight else _EDGE_POINTS)
            chains.append(np.array([[p.X, p.Y] for p in edge.positions(t.tolist())]))
    return (
        np.concatenate([chain[:-1] for chain in chains]),
        np.concatenate([chain[1:] for chain in chains]),
    )


def _places(starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points inside the faces on a grid, and their distances to the edges."""
    low, high = starts.min(axis=0), starts.max(axis=0)
    # Off the round fractions of the outline, so that no ray below meets a corner of it.
    fractions = (np.arange(_GRID) + 0.382) / _GRID
    axes = [a + (b - a) * fractions for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = np.zeros(len(grid), dtype=bool)
    room = np.full(len(grid), np.inf)
    for a, b in zip(starts, ends, strict=True):
        along = b - a
        t = np.clip((grid - a) @ along / max(float(along @ along), 1e-300), 0, 1)
        room = np.minimum(room, np.linalg.norm(grid - a - t[:, None] * along, axis=1))
        # Even-odd rule: a ray along +x crosses the edges an odd number of times from inside.
        if a[1] != b[1]:
            crosses = (a[1] > grid[:, 1]) != (b[1] > grid[:, 1])
            at_x = a[0] + (grid[:, 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
            inside ^= crosses & (grid[:, 0] < at_x)
    return grid[inside], room[inside]
