# SPDX-License-Identifier: Apache-2.0
"""Pads as B-rep solids with named faces, made with build123d from their formulas.

A pad of your own derives from ``HeightPad`` or ``DomePad``, or registers its solid with
``labelled_solid.register``.
"""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from functools import singledispatch

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
from OCP.Standard import Standard_Failure
from OCP.StdFail import StdFail_NotDone

from taccel_lab.cad.parts.dome_pad import DomePad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.graph_surface import creased_graph_face, smooth_graph_face
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.meridian import Arc, Piece
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.cad.parts.pad_outline import PadOutline
from taccel_lab.cad.parts.part import LabelledSolid, Part, gel_part
from taccel_lab.cad.parts.solids import imprint, one_solid, prism
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

_CREASED_GRID_MM = 1.6
_BAND_LINES = 8
_MARGIN_MM = 0.5
_PLANE_TOLERANCE_MM = 1e-6
_VOLUME_TOLERANCE, _GRID_TOLERANCE = 1e-6, 0.01
"""Relative errors of a dome's exact volume, and of one that is summed over the height map."""
_ON_LAYER_MM = 1e-3
_LAYER_GRID = (0.011, 0.27, 0.51, 0.73, 0.989)
_LAYER_COLORS = {"gel": (0.93, 0.80, 0.62), "skin": (0.25, 0.25, 0.27)}
_KERNEL_ERRORS = (ValueError, Standard_Failure, StdFail_NotDone)


@singledispatch
def labelled_solid(pad: Pad) -> LabelledSolid:
    """The body of ``pad`` as a CAD solid with labelled faces.

    Raises InputError when the CAD kernel cannot build the combination; says which bound it breaks.
    """
    raise InputError(
        f"no CAD solid is known for a {type(pad).__name__}; that of an imported gel is the STEP "
        "file that it came from"
    )


@labelled_solid.register
def _height_pad_solid(pad: HeightPad) -> LabelledSolid:
    """Extruded outline, crowned top, rim, window imprinted on the back."""
    rim = f"a rim of {pad.rim_setback_mm():g} mm"
    try:
        body = _imprint_window(pad, _body(pad))
    except _KERNEL_ERRORS as error:
        raise InputError(
            f"the CAD kernel cannot build this pad ({error}); with {rim} try a smaller rim_mm, or "
            "larger radii of the contact face"
        ) from error
    # Between a nearly flat face and a rim the kernel may leave the rim out of a valid solid.
    exact = pad.volume_mm3()
    if not body.is_valid or abs(body.volume / exact - 1) > _GRID_TOLERANCE:
        raise InputError(
            f"the CAD kernel built an invalid solid for {rim}: {body.volume:.1f} mm3 where the pad "
            f"has {exact:.1f} mm3; use a smaller rim_mm, or other radii of the contact face"
        )
    return LabelledSolid(body, [_face_region(pad, face) for face in body.faces()])


@labelled_solid.register
def _dome_pad_solid(pad: DomePad) -> LabelledSolid:
    """The meridian revolved about z; each face takes the region of the piece it lies on."""
    try:
        edges = [_edge(piece) for piece in pad.meridian.pieces]
        edges.append(Edge.make_line(edges[-1] @ 1, edges[0] @ 0))
        section = Face(Wire(edges))
        body = Solid.revolve(section, 360, Axis.Z)
    except _KERNEL_ERRORS as error:
        raise InputError(f"the CAD kernel cannot revolve this dome ({error})") from error
    exact = pad.volume_mm3()
    if not body.is_valid or abs(body.volume / exact - 1) > _VOLUME_TOLERANCE:
        raise InputError(
            f"the CAD kernel built a dome of {body.volume:.3f} mm3 from a meridian that encloses "
            f"{exact:.3f} mm3; its pieces are too small or too close to each other"
        )
    points = np.array([_point_on(face) for face in body.faces()])
    return LabelledSolid(body, [Region(int(r)) for r in pad.region_of(points)])


def layer_solids(pad: Pad) -> dict[str, Solid]:
    """Solid of each layer by its name; the skin is the body without the gel proper.

    Raises InputError when the CAD kernel cannot build the combination.
    """
    body = labelled_solid(pad).solid
    if not isinstance(pad, HeightPad) or not pad.skin_top_mm:
        return {pad.layer_names[0]: body}
    inside = _prism(pad, pad.outline.inset(pad.skin_side_mm))
    try:
        gel = one_solid(inside & (Pos(0, 0, -pad.skin_top_mm) * body))
        return {"gel": gel, "skin": one_solid(body - gel)}
    except _KERNEL_ERRORS as error:
        raise InputError(
            f"the CAD kernel cannot build the skin of {pad.skin_top_mm:g} mm on the contact face "
            f"and {pad.skin_side_mm:g} mm on the wall ({error}); change skin_top_mm or skin_side_mm"
        ) from error


def gel_parts(pad: Pad, gel: LabelledSolid) -> tuple[Part, ...]:
    """The gel as one part, or its layers as a part each, core first."""
    layers = gel_layers(pad, gel)
    if len(layers) < 2:
        return (gel_part(gel),)
    return tuple(
        Part(
            name=name,
            solid=layer.solid,
            face_names=tuple(region.name.lower() for region in layer.regions),
            color=_LAYER_COLORS.get(name, (0.6, 0.6, 0.6)),
            material=f"silicone, {name}",
            gel=True,
        )
        for name, layer in layers.items()
    )


def gel_layers(pad: Pad, gel: LabelledSolid) -> dict[str, LabelledSolid]:
    """The layers of the gel by name, core first; a face inside the gel counts as side."""
    names: list[str] = list(pad.layer_names)
    if len(names) == 1:
        return {names[0]: gel}
    layers = {name: _with_window(solid, gel) for name, solid in layer_solids(pad).items()}
    return {
        name: LabelledSolid(solid, [_region_of(face, gel) for face in solid.faces()])
        for name, solid in layers.items()
    }


def _with_window(layer: Solid, gel: LabelledSolid) -> Solid:
    """The layer with the gel's window drawn on a face that holds all of it."""
    for window in gel.faces(Region.WINDOW):
        for face in layer.faces():
            spare = face.area - window.area
            if spare > _ON_LAYER_MM and face.distance_to(window.center()) < _ON_LAYER_MM:
                return imprint(layer, face, window.outer_wire())
    return layer


def _region_of(face: Face, gel: LabelledSolid) -> Region:
    """Region of the face of the whole gel that a layer's face is a part of."""
    # A face may have a hole in its middle.
    grid = [(u, v) for u in _LAYER_GRID for v in _LAYER_GRID]
    points = [point for point in (face.position_at(*uv) for uv in grid) if face.is_inside(point)]
    for whole, region in zip(gel.solid.faces(), gel.regions, strict=True):
        if points and all(whole.distance_to(point) < _ON_LAYER_MM for point in points):
            return region
    return Region.SIDE


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
        top = block if pad.is_flat else one_solid(block & _under_crown(pad))
        if pad.rim == "chamfer":
            return one_solid(chamfer(_top_edges(top), pad.rim_mm))
    else:
        top = one_solid(block & _under_crown(pad))
    return one_solid(fillet(_top_edges(top), pad.rim_setback_mm())) if pad.has_fillet else top


def _prism(pad: HeightPad, outline: PadOutline) -> Solid:
    return prism(Face(outline_wire(outline, -pad.thickness_mm)), pad.thickness_mm)


def _top_edges(body: Solid) -> ShapeList[Edge]:
    return body.faces().sort_by(Axis.Z)[-1].edges()


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
        return one_solid(block & Solid.extrude(face, (0, 0, -pad.thickness_mm - 1)))
    top, drop = block.faces().sort_by(Axis.Z)[-1], pad.thickness_mm - pad.wall_mm
    if pad.rim_mm < pad.corner_radius_mm:
        return one_solid(chamfer(top.edges(), pad.rim_mm, drop, reference=top))
    return one_solid(block & _frustum(pad, pad.rim_mm / drop))


def _frustum(pad: GelPad, spread: float) -> Solid:
    """Solid under four planes that widen by ``spread`` per height, from the inner outline down."""
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
    return imprint(body, back, wire)


def _face_region(pad: HeightPad, face: Face) -> Region:
    """What a face is for, from where it lies; no face is recognised by its number."""
    box = face.bounding_box()
    if abs(box.max.Z + pad.thickness_mm) < _PLANE_TOLERANCE_MM:
        inside = box.max.X < pad.window_x_mm / 2 + 1e-3 and box.max.Y < pad.window_y_mm / 2 + 1e-3
        return Region.WINDOW if inside else Region.BOND
    if box.min.Z < -pad.thickness_mm + _PLANE_TOLERANCE_MM:
        return Region.BOND if pad.sides_bonded else Region.SIDE
    return Region.CONTACT


def _edge(piece: Piece) -> Edge:
    """The piece as an edge in the plane y = 0."""
    at = [(float(r), 0.0, float(z)) for r, z in piece.point(np.array([0.0, 0.5, 1.0]))]
    if isinstance(piece, Arc):
        return Edge.make_three_point_arc(*at)
    return Edge.make_line(at[0], at[2])


def _point_on(face: Face) -> np.ndarray:
    """A point well inside a face, also one with a hole: the centre of its largest triangle."""
    vertices, triangles = face.tessellate(0.01)
    corners = np.array([tuple(v) for v in vertices])[np.array(triangles)]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    return corners[int(areas.argmax())].mean(axis=0)
