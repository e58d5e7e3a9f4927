# SPDX-License-Identifier: Apache-2.0
"""What an imported body must be before it is meshed: one closed, clean solid with thickness."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from build123d import Solid
from OCP.BOPAlgo import BOPAlgo_CheckStatus
from OCP.BRep import BRep_Tool
from OCP.BRepAlgoAPI import BRepAlgoAPI_Check
from OCP.BRepCheck import BRepCheck_Analyzer

from cad.mesh.surface import LabelledSurface
from cad.step_import.reader import StepBody
from taccel_lab.errors import InputError

MIN_THICKNESS_MM = 0.05
"""Least thickness of a body anywhere but at its edges [mm]."""
_PROBES = 600
_OPPOSITE = -0.9
_AREA_SHARE = 1e-6


def one_solid(bodies: Sequence[StepBody], path: Path, name: str | None) -> StepBody:
    """The only solid of a file, or the one of a name."""
    solids = [body for body in bodies if body.is_solid]
    if not solids:
        open_edges = sum(_open_edges(body) for body in bodies)
        raise InputError(
            f"{path} holds {len(bodies)} shell(s) but no solid: the surface is open at "
            f"{open_edges} edges. Close it and export a solid"
        )
    if name is not None:
        solids = [body for body in solids if body.name == name]
    if len(solids) == 1:
        return solids[0]
    words = ", ".join(
        f"{body.name or 'without a name'} ({body.shape.volume:.1f} mm^3)"
        for body in bodies
        if body.is_solid
    )
    wanted = f" of the name {name!r}" if name is not None else ""
    raise InputError(
        f"{path} holds {len(solids)} solids{wanted}; one is needed. There are: {words}. Say which "
        "one with --body NAME, or export the gel alone"
    )


def _open_edges(body: StepBody) -> int:
    faces = body.shape.faces()
    edges = [edge for face in faces for edge in face.edges()]
    return sum(sum(edge.is_same(other) for other in edges) == 1 for edge in edges)


def check_solid(solid: Solid, path: Path) -> None:
    """Raise InputError for an open, invalid, inside-out or self-intersecting solid."""
    for shell in solid.shells():
        if not BRep_Tool.IsClosed_s(shell.wrapped):
            raise InputError(f"{path}: the solid's shell is open, so that it is not watertight")
    # The first two arguments after the shape: no test for small edges, one for self-interference.
    found = BRepAlgoAPI_Check(solid.wrapped, False, True)
    crossings = sum(
        result.GetCheckStatus() == BOPAlgo_CheckStatus.BOPAlgo_SelfIntersect
        for result in found.Result()
    )
    if crossings:
        raise InputError(
            f"{path}: the solid intersects itself in {crossings} places; repair it in the program "
            "that it comes from"
        )
    if not BRepCheck_Analyzer(solid.wrapped).IsValid():
        bad = [
            k
            for k, face in enumerate(solid.faces())
            if not BRepCheck_Analyzer(face.wrapped).IsValid()
        ]
        where = f" (faces {', '.join(map(str, bad[:10]))})" if bad else ""
        raise InputError(
            f"{path}: the CAD kernel finds the solid invalid{where}; repair it in the program that "
            "it comes from"
        )
    if solid.volume <= 0:
        raise InputError(f"{path}: the solid has a volume of {solid.volume:.3g} mm^3")


def check_thickness(surface: LabelledSurface, path: Path) -> float:
    """Least thickness seen from the middles of triangles, straight inward [mm].

    A ray counts where it meets a face that looks the other way, so that the sharp edge between two
    faces is not taken for a thin sheet. Raises InputError below 0.05 mm.
    """
    corners = surface.vertices_mm[surface.triangles]
    areas, normals = surface.areas_mm2(), surface.normals()
    real = np.flatnonzero(areas > _AREA_SHARE * areas.sum())
    step = max(len(real) // _PROBES, 1)
    probes = real[::step]
    starts = corners[probes].mean(axis=1)
    best, where = np.inf, np.zeros(3)
    for k, start in zip(probes, starts, strict=True):
        opposite = normals @ normals[k] < _OPPOSITE
        distance = _first_hit(start, -normals[k], corners[opposite])
        if distance < best:
            best, where = distance, start
    if best < MIN_THICKNESS_MM:
        raise InputError(
            f"{path}: the body is {best:.3g} mm thick at x {where[0]:.2f}, y {where[1]:.2f}, "
            f"z {where[2]:.2f} mm; allowed: at least {MIN_THICKNESS_MM} mm"
        )
    return float(best)


def _first_hit(start: np.ndarray, way: np.ndarray, corners: np.ndarray) -> float:
    """Distance along a ray to the nearest of some triangles (Moeller and Trumbore, 1997)."""
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(way, edge2)
    determinant = (edge1 * p).sum(axis=1)
    good = np.abs(determinant) > 1e-300
    inverse = np.where(good, 1 / np.where(good, determinant, 1), 0)
    offset = start - corners[:, 0]
    u = (offset * p).sum(axis=1) * inverse
    q = np.cross(offset, edge1)
    v = (q @ way) * inverse
    t = (edge2 * q).sum(axis=1) * inverse
    hit = good & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > -1e-9)
    return float(t[hit].min(initial=np.inf))
