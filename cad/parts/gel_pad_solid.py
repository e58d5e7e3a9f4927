# SPDX-License-Identifier: Apache-2.0
"""The gel pad as a B-rep solid with named faces, made with build123d from the formulas."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
from build123d import (
    Axis,
    Face,
    Location,
    Plane,
    Pos,
    RectangleRounded,
    ShapeList,
    Solid,
    Wire,
    chamfer,
    fillet,
)
from build123d.topology import Shape
from OCP.BRepFeat import BRepFeat_SplitShape
from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism
from OCP.gp import gp_Vec
from OCP.Standard import Standard_Failure
from OCP.StdFail import StdFail_NotDone

from cad.parts.gel_pad import GelPad
from cad.parts.labelled_solid import LabelledSolid
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

# A grid of about 1 mm: finer ones follow the noise of the fit instead of the shape.
_SURFACE_GRID_MM = 1.0
_SURFACE_TOLERANCE_MM = 1e-4
_PLANE_TOLERANCE_MM = 1e-6


def gel_pad_solid(pad: GelPad) -> LabelledSolid:
    """Build the solid of ``pad``: extruded outline, crowned top, rim, window imprinted on the back.

    Raises InputError when the CAD kernel cannot build the combination.
    """
    outline = RectangleRounded(pad.length_x_mm, pad.length_y_mm, pad.corner_radius_mm)
    back = (Pos(0, 0, -pad.thickness_mm) * outline).faces()[0]
    # Copied, so that no face is a moved twin of another: STEP files lose the names of twins.
    prism = Solid(BRepPrimAPI_MakePrism(back.wrapped, gp_Vec(0, 0, pad.thickness_mm), True).Shape())
    try:
        body = _single(prism if pad.is_flat else prism & _crown_solid(pad))
        body = _with_rim(pad, body)
        body = _imprint_window(pad, body)
    except (ValueError, Standard_Failure, StdFail_NotDone) as error:
        raise InputError(
            f"the CAD kernel cannot build this pad ({error}); with rim {pad.rim!r} try a smaller "
            f"rim_mm than {pad.rim_mm:g}, or larger crown radii"
        ) from error
    if not body.is_valid or body.volume <= 0:
        raise InputError(
            f"the CAD kernel built an invalid solid for rim {pad.rim!r} of {pad.rim_mm:g} mm; "
            "use a smaller rim_mm or larger crown radii"
        )
    return LabelledSolid(body, [_face_region(pad, face) for face in body.faces()])


def _single(part: Shape | ShapeList | None) -> Solid:
    solids = part.solids() if part is not None else []
    if len(solids) != 1:
        raise ValueError(f"{len(solids)} bodies instead of one")
    return solids[0]


def _crown_solid(pad: GelPad) -> Solid:
    """A solid whose upper face is the crown and which contains the rest of the pad."""
    if pad.is_spherical:
        return Solid.make_sphere(
            pad.crown_radius_x_mm, Plane(Location((0, 0, -pad.crown_radius_x_mm)))
        )
    half = np.array([pad.length_x_mm, pad.length_y_mm]) / 2 + 0.5
    counts = np.maximum(np.ceil(2 * half / _SURFACE_GRID_MM).astype(int), 8)
    axes = [np.linspace(-h, h, n) for h, n in zip(half, counts, strict=True)]
    xy = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    points = np.concatenate([xy, pad.crown_mm(xy)[..., None]], axis=-1)
    face = Face.make_surface_from_array_of_points(
        [[tuple(p) for p in row] for row in points.tolist()],  # type: ignore[arg-type]
        tol=_SURFACE_TOLERANCE_MM,
        min_deg=3,
        max_deg=5,
    )
    return Solid.extrude(face, (0, 0, -pad.thickness_mm - 1))


def _with_rim(pad: GelPad, body: Solid) -> Solid:
    if pad.rim == "none":
        return body
    top = body.faces().sort_by(Axis.Z)[-1]
    if pad.rim == "chamfer":
        return _single(chamfer(top.edges(), pad.rim_mm))
    return _single(fillet(top.edges(), pad.rim_mm))


def _imprint_window(pad: GelPad, body: Solid) -> Solid:
    """Split the back into the window rectangle and the rest."""
    z = -pad.thickness_mm
    back = body.faces().sort_by(Axis.Z)[0]
    x, y = pad.window_x_mm / 2, pad.window_y_mm / 2
    wire = Wire.make_polygon([(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)], close=True)
    split = BRepFeat_SplitShape(body.wrapped)
    split.Add(wire.wrapped, back.wrapped)
    split.Build()
    return _single(Solid.cast(split.Shape()))


def _face_region(pad: GelPad, face: Face) -> Region:
    """What a face is for, from where it lies; no face is recognised by its number."""
    box = face.bounding_box()
    if abs(box.max.Z + pad.thickness_mm) < _PLANE_TOLERANCE_MM:
        inside = box.max.X < pad.window_x_mm / 2 + 1e-3 and box.max.Y < pad.window_y_mm / 2 + 1e-3
        return Region.WINDOW if inside else Region.BOND
    if box.min.Z < -pad.thickness_mm + _PLANE_TOLERANCE_MM:
        return Region.SIDE
    return Region.CONTACT
