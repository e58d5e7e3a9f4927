# SPDX-License-Identifier: Apache-2.0
"""A dome pad as a B-rep solid with named faces: its meridian, revolved with build123d."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
from build123d import Axis, Edge, Face, Solid, Wire
from OCP.Standard import Standard_Failure
from OCP.StdFail import StdFail_NotDone

from taccel_lab.cad.parts.dome_pad import DomePad
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.meridian import Arc, Piece
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

_VOLUME_TOLERANCE = 1e-6


def dome_pad_solid(pad: DomePad) -> LabelledSolid:
    """Revolve the meridian of ``pad`` about z; each face takes the region of the piece it lies on.

    Raises InputError when the CAD kernel cannot build the combination.
    """
    try:
        edges = [_edge(piece) for piece in pad.meridian.pieces]
        edges.append(Edge.make_line(edges[-1] @ 1, edges[0] @ 0))
        section = Face(Wire(edges))
        body = Solid.revolve(section, 360, Axis.Z)
    except (ValueError, Standard_Failure, StdFail_NotDone) as error:
        raise InputError(f"the CAD kernel cannot revolve this dome ({error})") from error
    exact = pad.meridian.volume_mm3()
    if not body.is_valid or abs(body.volume / exact - 1) > _VOLUME_TOLERANCE:
        raise InputError(
            f"the CAD kernel built a dome of {body.volume:.3f} mm3 from a meridian that encloses "
            f"{exact:.3f} mm3; its pieces are too small or too close to each other"
        )
    points = np.array([_point_on(face) for face in body.faces()])
    return LabelledSolid(body, [Region(int(r)) for r in pad.region_of(points)])


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
