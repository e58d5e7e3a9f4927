# SPDX-License-Identifier: Apache-2.0
"""The gel as it is cast: larger by the shrinkage, its outer vertical walls drafted.

The draft adds a wedge round the foot of the wall, from the lowest edge of the contact face down to
the parting plane; contact face, window and inner surfaces stay exact. Where a crowned face makes
the wall higher than its lowest place, the rest above the wedge stays vertical.

Plane facets that stand for a wall lean a little. The wedge then begins inside of the outline, so
that no gap is left behind it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from build123d import Edge, Face, GeomType, Solid, Vector, Wire

from taccel_lab.cad.parts.solids import base_outline, grown, prism
from taccel_lab.errors import InputError

_VERTICAL = 1e-4
_ON_OUTLINE_MM = 1e-3
_SAMPLES = (0.05, 0.275, 0.5, 0.725, 0.95)
_LEAST_WEDGE_MM = 0.2
_BELOW_EDGE_MM = 0.02


@dataclass(frozen=True)
class CastBody:
    """What fills the closed mould [mm]."""

    solid: Solid
    base_z_mm: float
    """The parting plane."""
    outline: Wire
    """Outline of the gel, without draft, in the parting plane."""
    draft_height_mm: float
    """Height of the drafted wall above the parting plane; 0 when there is no vertical wall."""
    draft_width_mm: float
    """What the draft adds on every side at the parting plane."""
    draft_volume_mm3: float
    vertical_mm: float
    """Greatest height of wall above the wedge that stays vertical."""


def cast_body(
    gel: Solid, *, draft_deg: float, shrinkage_percent: float, facets_mm: float = 0.0
) -> CastBody:
    """Scale ``gel`` about the origin by 1 / (1 - shrinkage) and draft its outer walls.

    ``facets_mm``: how far plane facets of ``gel`` lie off the faces that they stand for; 0 for
    exact ones.
    """
    grown_gel = gel if not shrinkage_percent else gel.scale(1 / (1 - shrinkage_percent / 100))
    base = grown_gel.bounding_box().min.Z
    outline = base_outline(grown_gel)
    lean = math.sin(math.radians(draft_deg)) if facets_mm else _VERTICAL
    walls = _outer_walls(grown_gel, outline, base, lean, max(facets_mm, _ON_OUTLINE_MM))
    tops = _wall_tops_mm(walls, base)
    # A little lower than the edge of the contact face, which the wedge must not touch.
    height = float(tops.min() - base) - _BELOW_EDGE_MM if len(tops) else 0.0
    highest = float(tops.max() - base) if len(tops) else 0.0
    slope = math.tan(math.radians(draft_deg))
    if height < _LEAST_WEDGE_MM or draft_deg == 0:
        return CastBody(grown_gel, base, outline, 0.0, 0.0, 0.0, highest)
    wedge = _wedge(outline, base, height, draft_deg, facets_mm)
    merged = (grown_gel + wedge).solids()
    if len(merged) != 1 or not merged[0].is_valid:
        raise InputError(
            f"the CAD kernel cannot draft the walls of this gel by {draft_deg:g} deg; use another "
            "draft_deg, or 0"
        )
    return CastBody(
        solid=merged[0],
        base_z_mm=base,
        outline=outline,
        draft_height_mm=height,
        draft_width_mm=slope * height,
        draft_volume_mm3=merged[0].volume - grown_gel.volume,
        vertical_mm=highest - height,
    )


def _wedge(outline: Wire, base: float, height: float, draft_deg: float, inside_mm: float) -> Solid:
    """The ring from ``inside_mm`` within the outline, pulled straight up, to a cone that meets the
    outline at the top."""
    top = grown(outline, 0.0, base + height)
    cone = Solid.extrude_taper(top, (0, 0, -height), -draft_deg)
    return cone.cut(prism(grown(outline, -inside_mm, base), height)).solids()[0]


def is_vertical(face: Face, lean: float = _VERTICAL) -> bool:
    """Whether the face's normals are all horizontal, up to a z of ``lean``."""
    if face.geom_type == GeomType.PLANE:
        return abs(face.normal_at().Z) < lean
    points = [face.position_at(u, v) for u in _SAMPLES for v in _SAMPLES]
    return max(abs(face.normal_at(point).Z) for point in points) < lean


def _outer_walls(
    solid: Solid, outline: Wire, base: float, lean: float, near_mm: float
) -> list[Face]:
    """Upright faces that stand on the outline."""
    walls = []
    for face in solid.faces():
        if not is_vertical(face, lean):
            continue
        middle = face.position_at(0.5, 0.5)
        if outline.distance_to(Vector(middle.X, middle.Y, base)) < near_mm:
            walls.append(face)
    return walls


def _wall_tops_mm(walls: list[Face], base: float) -> np.ndarray:
    """z along the edges where the walls end above [mm]."""
    edges = [edge for wall in walls for edge in wall.edges()]
    heights: list[float] = []
    for edge in edges:
        shared = sum(edge.is_same(other) for other in edges) > 1
        points = [edge.position_at(t) for t in (0.0, *_SAMPLES, 1.0)]
        if shared or _is_upright(edge) or max(point.Z for point in points) < base + 1e-3:
            continue
        heights += [point.Z for point in points]
    return np.array(heights)


def _is_upright(edge: Edge) -> bool:
    start, end = edge.position_at(0), edge.position_at(1)
    return math.hypot(end.X - start.X, end.Y - start.Y) < 1e-6 < abs(end.Z - start.Z)
