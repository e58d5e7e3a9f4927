# SPDX-License-Identifier: Apache-2.0
"""Pads with a flat back as B-rep solids with named faces, made with build123d from the formulas."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
from build123d import (
    Axis,
    Edge,
    Face,
    Location,
    Plane,
    Pos,
    ShapeList,
    Shell,
    Solid,
    Wire,
    chamfer,
    fillet,
)
from build123d.topology import Shape
from OCP.BRepFeat import BRepFeat_SplitShape
from OCP.Standard import Standard_Failure
from OCP.StdFail import StdFail_NotDone

from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.graph_surface import creased_graph_face, smooth_graph_face
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.outline import prism
from taccel_lab.cad.parts.pad_outline import PadOutline
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

_CREASED_GRID_MM = 1.6
_BAND_LINES = 8
_MARGIN_MM = 0.5
_PLANE_TOLERANCE_MM = 1e-6


def gel_pad_solid(pad: HeightPad) -> LabelledSolid:
    """Build the solid of ``pad``: extruded outline, crowned top, rim, window imprinted on the back.

    Raises InputError when the CAD kernel cannot build the combination.
    """
    rim = f"a rim of {pad.rim_setback_mm():g} mm"
    try:
        body = _imprint_window(pad, _body(pad))
    except (ValueError, Standard_Failure, StdFail_NotDone) as error:
        raise InputError(
            f"the CAD kernel cannot build this pad ({error}); with {rim} try a smaller rim_mm, or "
            "larger radii of the contact face"
        ) from error
    if not body.is_valid or body.volume <= 0:
        raise InputError(
            f"the CAD kernel built an invalid solid for {rim}; use a smaller rim_mm or larger "
            "radii of the contact face"
        )
    return LabelledSolid(body, [_face_region(pad, face) for face in body.faces()])


def layer_solids(pad: HeightPad) -> dict[str, Solid]:
    """Solid of each layer by its name; the skin is the body without the gel proper.

    Raises InputError when the CAD kernel cannot build the combination.
    """
    body = gel_pad_solid(pad).solid
    if not pad.skin_top_mm:
        return {"gel": body}
    inside = _prism(pad, pad.outline.inset(pad.skin_wall_mm))
    try:
        gel = _single(inside & (Pos(0, 0, -pad.skin_top_mm) * body))
        return {"gel": gel, "skin": _single(body - gel)}
    except (ValueError, Standard_Failure, StdFail_NotDone) as error:
        raise InputError(
            f"the CAD kernel cannot build the skin of {pad.skin_top_mm:g} mm on the contact face "
            f"and {pad.skin_wall_mm:g} mm on the wall ({error}); change skin_mm or skin_side_mm"
        ) from error


def outline_wire(outline: PadOutline, z_mm: float) -> Wire:
    """The outline as arcs and straight edges in the plane at ``z_mm``."""
    edges = []
    for k, center in enumerate(outline.centers_mm):
        angles = outline.arc_angles[k]
        unit = [(np.cos(a), np.sin(a)) for a in (angles[0], angles.mean(), angles[1])]
        through = [(*(center + outline.radii_mm[k] * np.array(u)), z_mm) for u in unit]
        edges.append(Edge.make_three_point_arc(*through))
        side = outline.side_ends_mm[k]
        if np.linalg.norm(side[1] - side[0]) > 1e-6:
            edges.append(Edge.make_line((*side[0], z_mm), (*side[1], z_mm)))
    return Wire(edges)


def _body(pad: HeightPad) -> Solid:
    block = _prism(pad, pad.outline)
    if isinstance(pad, GelPad):
        if pad.has_band:
            return _banded(pad, block)
        top = block if pad.is_flat else _single(block & _under_crown(pad))
        if pad.rim == "chamfer":
            return _single(chamfer(_top_edges(top), pad.rim_mm))
    else:
        top = _single(block & _under_crown(pad))
    return _single(fillet(_top_edges(top), pad.rim_setback_mm())) if pad.has_fillet else top


def _prism(pad: HeightPad, outline: PadOutline) -> Solid:
    return prism(Face(outline_wire(outline, -pad.thickness_mm)), pad.thickness_mm)


def _top_edges(body: Solid) -> ShapeList[Edge]:
    return body.faces().sort_by(Axis.Z)[-1].edges()


def _single(part: Shape | ShapeList | None) -> Solid:
    solids = part.solids() if part is not None else []
    if len(solids) != 1:
        raise ValueError(f"{len(solids)} bodies instead of one")
    return solids[0]


def _under_crown(pad: HeightPad) -> Solid:
    """A solid whose upper face is the crown and which contains the rest of the pad."""
    if isinstance(pad, GelPad) and pad.is_spherical and not pad.crown_pillow:
        radius = pad.crown_radius_x_mm
        return Solid.make_sphere(radius, Plane(Location((0, 0, -radius))))
    bounds = pad.outline.bounds_mm() + np.array([[-_MARGIN_MM], [_MARGIN_MM]])
    face = smooth_graph_face(pad.crown_mm, bounds)
    return Solid.extrude(face, (0, 0, -pad.thickness_mm - 1))


def _band_lines(half_mm: float, width_mm: float) -> np.ndarray:
    """Grid lines that keep the crease where the band meets the crown on a line."""
    inner = half_mm - width_mm
    beyond = inner + width_mm * np.arange(1, _BAND_LINES + 1) / _BAND_LINES
    beyond = np.append(beyond, half_mm + _MARGIN_MM)
    between = np.linspace(-inner, inner, max(4, int(np.ceil(2 * inner / _CREASED_GRID_MM)) + 1))
    return np.concatenate([-beyond[::-1], between, beyond])


def _banded(pad: GelPad, block: Solid) -> Solid:
    """Rims that rise from a wall of given height: a bevel by the kernel or planes, or an arc."""
    if pad.rim == "arc":
        sizes = (pad.length_x_mm, pad.length_y_mm)
        face = creased_graph_face(
            pad.height_mm, *(_band_lines(size / 2, pad.rim_mm) for size in sizes)
        )
        return _single(block & Solid.extrude(face, (0, 0, -pad.thickness_mm - 1)))
    top, drop = block.faces().sort_by(Axis.Z)[-1], pad.thickness_mm - pad.wall_mm
    if pad.rim_mm < pad.corner_radius_mm:
        return _single(chamfer(top.edges(), pad.rim_mm, drop, reference=top))
    return _single(block & _frustum(pad, pad.rim_mm / drop))


def _frustum(pad: GelPad, spread: float) -> Solid:
    """Under four planes that widen by ``spread`` per height, from the inner outline down."""
    half = np.array([pad.length_x_mm, pad.length_y_mm]) / 2
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    depth = pad.thickness_mm + 1
    corners = [
        [(*(sign * (half - pad.rim_mm + spread * down)), -down) for sign in signs]
        for down in (0.0, depth)
    ]
    loops = [corners[0], corners[1]]
    for k in range(4):
        m = (k + 1) % 4
        loops.append([corners[0][k], corners[0][m], corners[1][m], corners[1][k]])
    return Solid(Shell([Face(Wire.make_polygon(loop, close=True)) for loop in loops]))


def _imprint_window(pad: HeightPad, body: Solid) -> Solid:
    """Split the back into the window rectangle and the rest."""
    z = -pad.thickness_mm
    back = body.faces().sort_by(Axis.Z)[0]
    x, y = pad.window_x_mm / 2, pad.window_y_mm / 2
    wire = Wire.make_polygon([(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)], close=True)
    split = BRepFeat_SplitShape(body.wrapped)
    split.Add(wire.wrapped, back.wrapped)
    split.Build()
    return _single(Solid.cast(split.Shape()))


def _face_region(pad: HeightPad, face: Face) -> Region:
    """What a face is for, from where it lies; no face is recognised by its number."""
    box = face.bounding_box()
    if abs(box.max.Z + pad.thickness_mm) < _PLANE_TOLERANCE_MM:
        inside = box.max.X < pad.window_x_mm / 2 + 1e-3 and box.max.Y < pad.window_y_mm / 2 + 1e-3
        return Region.WINDOW if inside else Region.BOND
    if box.min.Z < -pad.thickness_mm + _PLANE_TOLERANCE_MM:
        return Region.BOND if pad.sides_bonded else Region.SIDE
    return Region.CONTACT
