# SPDX-License-Identifier: Apache-2.0
"""Plane curves of a solid for a drawing: the plan seen from in front, sections through the apex."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from build123d import Edge, Face, GeomType, Plane, Solid, Wire
from OCP.BRep import BRep_Tool
from OCP.GCPnts import GCPnts_AbscissaPoint

from taccel_lab.cad.parts.solids import section_faces

_PLANES = {"x": Plane.XZ, "y": Plane.YZ}
_STEP_MM = 0.15
_STRAIGHT = (GeomType.LINE,)
_CREASE_DEG = 30.0
"""Planes that turn less are facets of a curved surface, as in files of triangles."""


@dataclass(frozen=True)
class SectionEdge:
    """One edge of a section in its own plane: u along x or y, v along z."""

    points: np.ndarray
    """[n, 2] [mm]."""
    radius_mm: float
    """Radius of a circular arc; 0 for anything else."""
    middle: tuple[float, float, float]
    """A point of it in the gel frame."""


@dataclass(frozen=True)
class DrawnSection:
    """The cut faces of a solid in a plane through the z axis."""

    faces: tuple[tuple[np.ndarray, ...], ...]
    """Closed loops of each cut face, the outer one first, each [n, 2]."""
    edges: tuple[SectionEdge, ...]


def section(solid: Solid, along: str) -> DrawnSection:
    """Cut with the plane y = 0 (``along`` = "x") or x = 0 (``along`` = "y")."""
    column = 0 if along == "x" else 1
    loops, edges = [], []
    for face in section_faces(solid, _PLANES[along]):
        wires = (face.outer_wire(), *face.inner_wires())
        loops.append(tuple(chain(wire)[:, [column, 2]] for wire in wires))
        for edge in face.edges():
            middle = edge.position_at(0.5)
            edges.append(
                SectionEdge(
                    points=edge_points(edge)[:, [column, 2]],
                    radius_mm=edge.radius if edge.geom_type == GeomType.CIRCLE else 0.0,
                    middle=(middle.X, middle.Y, middle.Z),
                )
            )
    return DrawnSection(tuple(loops), tuple(edges))


def edge_points(edge: Edge) -> np.ndarray:
    """Points along an edge, [n, 3] [mm]."""
    count = 2 if edge.geom_type in _STRAIGHT else int(np.clip(edge.length / _STEP_MM, 8, 400))
    # As ``edge.positions``, which measures the edge anew for every point.
    curve = edge.geom_adaptor()
    first, length = curve.FirstParameter(), GCPnts_AbscissaPoint.Length_s(curve)
    shares = np.linspace(0, 1, count)
    shares = shares if edge.is_forward else 1 - shares
    points = [
        curve.Value(GCPnts_AbscissaPoint(curve, length * share, first).Parameter())
        for share in shares.tolist()
    ]
    return np.array([(point.X(), point.Y(), point.Z()) for point in points])


def chain(wire: Wire) -> np.ndarray:
    """Points round a closed wire, [n, 3] [mm]."""
    left = [edge_points(edge) for edge in wire.edges()]
    joined = [left.pop(0)]
    while left:
        end = joined[-1][-1]
        gaps = [min(np.linalg.norm(e[0] - end), np.linalg.norm(e[-1] - end)) for e in left]
        if len(joined) == 1:
            start = joined[0][0]
            other = [min(np.linalg.norm(e[0] - start), np.linalg.norm(e[-1] - start)) for e in left]
            if min(other) < min(gaps):
                joined[0], gaps = joined[0][::-1], other
                end = joined[0][-1]
        piece = left.pop(int(np.argmin(gaps)))
        if np.linalg.norm(piece[-1] - end) < np.linalg.norm(piece[0] - end):
            piece = piece[::-1]
        joined.append(piece)
    return np.concatenate([piece[:-1] for piece in joined])


def plan_edges(faces: Sequence[Face]) -> list[np.ndarray]:
    """Edges of faces seen along z, without seams, upright ones and those between facets of a curved
    surface, each [n, 2] [mm]."""
    facets = _facet_edges(faces)
    chains = [
        edge_points(edge)[:, :2]
        for face in faces
        for edge in face.edges()
        if not BRep_Tool.IsClosed_s(edge.wrapped, face.wrapped) and _ends(edge) not in facets
    ]
    return [points for points in chains if np.ptp(points, axis=0).max() > 1e-6]


def _facet_edges(faces: Sequence[Face]) -> set[frozenset[tuple[float, ...]]]:
    """Straight edges, by their ends, at which two planes turn less than ``_CREASE_DEG``."""
    normals: dict[frozenset[tuple[float, ...]], list[np.ndarray]] = {}
    for face in faces:
        if face.geom_type == GeomType.PLANE:
            normal = np.array(tuple(face.normal_at()))
            for edge in face.edges():
                normals.setdefault(_ends(edge), []).append(normal)
    least = np.cos(np.radians(_CREASE_DEG))
    return {ends for ends, own in normals.items() if len(own) == 2 and own[0] @ own[1] > least}


def _ends(edge: Edge) -> frozenset[tuple[float, ...]]:
    return frozenset(tuple(np.round(tuple(edge.position_at(t)), 6) + 0.0) for t in (0, 0.5, 1))


def circle_through(points: np.ndarray) -> float:
    """Radius of the circle fitted to plane points [mm]; inf when they lie on a line.

    Algebraic fit ``a (u^2 + v^2) + b u + c v + d = 0`` with a unit vector of coefficients, which
    also holds lines (a = 0).
    """
    u = points - points.mean(axis=0)
    size = float(np.abs(u).max())
    u = u / size
    matrix = np.column_stack([(u**2).sum(axis=1), u, np.ones(len(u))])
    a, b, c, d = np.linalg.svd(matrix)[2][-1]
    if abs(a) * 1e4 / size < max(abs(b), abs(c)) / 2:
        return float("inf")
    return float(np.sqrt(b**2 + c**2 - 4 * a * d) / (2 * abs(a)) * size)
