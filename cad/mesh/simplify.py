# SPDX-License-Identifier: Apache-2.0
"""A labelled surface of fewer triangles, as few as a tolerance permits; its deviation is measured.

VTK's quadric edge collapses (Garland and Heckbert, 1997) move vertices a little. Afterwards glued
vertices are put back onto the glued surface, and vertices that came out beyond the gel's base in
plan are pulled back above it: moulds need a base that is the widest place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.bodies.mesh_checks import check_surface
from taccel_lab.cad.mesh.closest import ClosestPoint, bond_projection, surface_distance
from taccel_lab.cad.mesh.surface import LabelledSurface, check_closed
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

_STEP = 0.8
"""Triangles of a try over those of the one before."""
_LEAST = 24
_FACES_DOWN = -0.5
"""Normals' z of the base, in distinction to walls that lean."""


@dataclass(frozen=True)
class Simplified:
    """A surface that stands for another one."""

    surface: LabelledSurface
    hausdorff_mm: float
    """Hausdorff distance of both, sampled both ways [mm]."""


def simplified(surface: LabelledSurface, tolerance_mm: float, most: int) -> Simplified:
    """The surface of at most ``most`` triangles, and as few as lie within ``tolerance_mm``.

    Raises InputError, with the distance and its place, when ``most`` triangles lie farther away.
    """
    best: Simplified | None = None
    current, count = surface, most
    while count >= _LEAST:
        current = _collapsed(surface, current, count, tolerance_mm)
        distance, (x, y, z), _ = surface_distance(
            (surface.vertices_mm, surface.triangles), (current.vertices_mm, current.triangles)
        )
        if distance > tolerance_mm and best is None:
            raise InputError(
                f"the gel has {len(surface.triangles):,} triangles, and its solid may have "
                f"{most:,}: these would lie {distance:.3g} mm off the file's at x {x:.2f}, "
                f"y {y:.2f}, z {z:.2f} mm (Hausdorff); allowed: {tolerance_mm:g} mm"
            )
        if distance > tolerance_mm or _folded(current):
            break
        best = Simplified(current, distance)
        count = int(_STEP * len(current.triangles))
    if best is None:
        raise InputError(
            f"the gel's {len(surface.triangles):,} triangles cannot be simplified to {most:,} "
            "without folds"
        )
    return best


def _collapsed(
    surface: LabelledSurface, current: LabelledSurface, count: int, reach_mm: float
) -> LabelledSurface:
    """``current``, an earlier stage of ``surface``, with ``count`` triangles."""
    import pyvista as pv

    whole = pv.PolyData.from_regular_faces(current.vertices_mm, current.triangles)
    fewer = whole.decimate(1 - count / len(current.triangles))
    points = np.asarray(fewer.points, dtype=np.float64)
    triangles = np.asarray(fewer.regular_faces, dtype=np.int32)
    check_closed(triangles, "the simplified surface")
    regions = _regions(surface, points[triangles])
    glued = np.unique(triangles[np.isin(regions, [int(Region.BOND), int(Region.WINDOW)])])
    points[glued] = bond_projection(surface)(points[glued])
    result = LabelledSurface(points, triangles, regions)
    # What faces down covers the base in plan; the closest point of its shadow is above the base.
    down = triangles[result.normals()[:, 2] < _FACES_DOWN]
    plan = points * [1, 1, 0]
    above, _ = ClosestPoint(plan, down).project(plan)
    near = np.linalg.norm(above - plan, axis=1) <= reach_mm
    points[near, :2] = above[near, :2]
    return LabelledSurface(points, triangles, regions)


def _regions(surface: LabelledSurface, corners: np.ndarray) -> np.ndarray:
    """Region of ``surface`` that all corners and the middle of a triangle lie closest to, [m]."""
    places = np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
    known = [region for region in Region if len(surface.of(region))]
    away = [
        ClosestPoint(surface.vertices_mm, surface.of(region))(places.reshape(-1, 3))[0]
        for region in known
    ]
    farthest = np.stack(away).reshape(len(known), -1, 4).max(axis=2)
    return np.array([int(region) for region in known], dtype=np.int32)[farthest.argmin(axis=0)]


def _folded(surface: LabelledSurface) -> bool:
    """Whether the surface crosses itself or has triangles without area."""
    try:
        check_surface(surface.vertices_mm, surface.triangles, "", closed=True)
    except InputError:
        return True
    return False
