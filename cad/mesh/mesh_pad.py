# SPDX-License-Identifier: Apache-2.0
"""A gel of any shape as a pad: its surfaces are triangles, no formula describes them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.shading_normals import corner_normals

if TYPE_CHECKING:
    from taccel_lab.cad.mesh.closest import ClosestPoint

THICKNESSES_MM = (0.2, 60.0)
"""Thicknesses that may be asked for [mm]."""
_INSIDE = -1e-9
"""Least weight of a corner at which a point still counts as over its triangle."""


@dataclass(frozen=True, eq=False, repr=False)
class SurfacePad(Pad):
    """The gel in a labelled surface. Over a place where its contact face lies in folds, the highest
    counts."""

    thickness_mm: float  # pyright: ignore[reportGeneralTypeIssues]
    surface: LabelledSurface = field(kw_only=True)

    @cached_property
    def digest(self) -> str:
        """Stands for the gel: the same digits for the same one."""
        found = hashlib.sha256()
        for array in self._arrays():
            found.update(array.tobytes())
        return found.hexdigest()[:16]

    def _arrays(self) -> tuple[np.ndarray, ...]:
        return self.surface.vertices_mm, self.surface.triangles, self.surface.regions

    def __repr__(self) -> str:
        return f"{type(self).__name__}(thickness_mm={self.thickness_mm!r}, gel={self.digest})"

    def bounds_mm(self) -> np.ndarray:
        points = self.surface.vertices_mm
        return np.stack([points.min(axis=0), points.max(axis=0)])

    def top_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        xy = np.asarray(xy_mm, dtype=np.float64)
        return self._top(xy.reshape(-1, 2))[0].reshape(xy.shape[:-1])

    def top_normal(self, xy_mm: np.ndarray) -> np.ndarray:
        """Outward unit normal of the contact face over gel xy, NaN beside it; [..., 2] ->
        [..., 3]. That of the curved face which the facets stand for."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        _, face, weights = self._top(xy.reshape(-1, 2))
        normal = np.einsum("ij,ijk->ik", weights, self._normals[face])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return normal.reshape(*xy.shape[:-1], 3)

    def inside_distance_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        xy = np.asarray(xy_mm, dtype=np.float64)
        points = xy.reshape(-1, 2)
        away = np.full(len(points), np.inf)
        for start, end in self._rim_mm:
            along, to = end - start, points - start
            share = np.clip(to @ along / (along @ along), 0.0, 1.0)
            away = np.minimum(away, np.linalg.norm(to - share[:, None] * along, axis=1))
        on_face = np.isfinite(self._top(points)[0])
        return np.where(on_face, away, -away).reshape(xy.shape[:-1])

    def contact_error_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """Distance of points from the contact face [mm], [n, 3] -> [n]."""
        return self._closest(Region.CONTACT)(np.asarray(points_mm, dtype=np.float64))[0]

    def bond_projection_mm(self, points_mm: np.ndarray) -> np.ndarray:
        closest = self._closest(Region.BOND, Region.WINDOW)
        return closest.project(np.asarray(points_mm, dtype=np.float64))[0]

    def figures(self) -> dict[str, float]:
        return {"volume_mm3": self.volume_mm3()}

    def volume_mm3(self) -> float:
        return self.surface.volume_mm3()

    def _closest(self, *regions: Region) -> ClosestPoint:
        from taccel_lab.cad.mesh.closest import ClosestPoint

        return ClosestPoint(self.surface.vertices_mm, self.surface.of(*regions))

    @cached_property
    def _facing(self) -> np.ndarray:
        """Which triangles of the contact face look up."""
        a, b, c = np.moveaxis(self.surface.vertices_mm[self._faces][..., :2], 1, 0)
        return _cross(b - a, c - a) > 0

    @cached_property
    def _faces(self) -> np.ndarray:
        return self.surface.of(Region.CONTACT)

    @cached_property
    def _normals(self) -> np.ndarray:
        """Normals at the corners of each triangle that looks up, [m, 3, 3]."""
        return corner_normals(1e-3 * self.surface.vertices_mm, self._faces)[self._facing]

    @cached_property
    def _rim_mm(self) -> np.ndarray:
        """Edges of the contact face that belong to one triangle, in plan [mm], [n, 2, 2]."""
        edges = np.sort(self._faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        once, count = np.unique(edges, axis=0, return_counts=True)
        ends = self.surface.vertices_mm[once[count == 1], :2]
        # An edge along z has no extent in plan.
        return ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 1e-9]

    def _top(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Height [mm], triangle among those that look up and weights of its corners, [n], [n],
        [n, 3]; NaN, 0 and NaN beside the face."""
        height = np.full(len(points), np.nan)
        face = np.zeros(len(points), dtype=np.int64)
        weights = np.full((len(points), 3), np.nan)
        corners = self.surface.vertices_mm[self._faces[self._facing]]
        for number, over, w in _over(points, corners[..., :2]):
            z = w @ corners[number, :, 2]
            higher = ~(z <= height[over])
            chosen = over[higher]
            height[chosen], face[chosen], weights[chosen] = z[higher], number, w[higher]
        return height, face, weights


class MeshPad(SurfacePad):
    """The gel of a mesh."""

    mesh: TetMesh

    def __init__(self, thickness_mm: float, *, mesh: TetMesh) -> None:
        object.__setattr__(self, "mesh", mesh)
        surface = LabelledSurface(1e3 * mesh.nodes_m, mesh.faces, mesh.face_regions)
        super().__init__(thickness_mm, surface=surface)

    def of_thickness(self, thickness_mm: float) -> MeshPad:
        """The same gel with its glued surface moved so that it is ``thickness_mm`` thick.

        Raises:
            InputError: The glued surface would touch or cross another one.
        """
        from taccel_lab.cad.mesh.moved_bond import moved_bond

        down_mm = thickness_mm - self.thickness_mm
        if down_mm == 0.0:
            return self
        try:
            mesh = moved_bond(self.mesh, down_mm)
        except InputError as error:
            raise InputError(
                f"the imported gel cannot be thickness_mm = {thickness_mm:g}: {error}; it is "
                f"{self.thickness_mm:.4g} mm thick. taccel-lab import-gel --thickness-mm "
                f"{thickness_mm:g} meshes it anew"
            ) from None
        return MeshPad(thickness_mm, mesh=mesh)

    def _arrays(self) -> tuple[np.ndarray, ...]:
        mesh = self.mesh
        return mesh.nodes_m, mesh.tets, mesh.faces, mesh.face_regions, mesh.tet_layers


def _over(points: np.ndarray, corners: np.ndarray) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yields each triangle in plan that has points over it: its number, which ones, their
    weights."""
    order = np.argsort(points[:, 0], kind="stable")
    x = points[order, 0]
    slack = 1e-9 * max(1.0, float(np.abs(corners).max(initial=0.0)))
    first = np.searchsorted(x, corners[..., 0].min(axis=1) - slack)
    last = np.searchsorted(x, corners[..., 0].max(axis=1) + slack, side="right")
    for number in np.flatnonzero(last > first):
        near = order[first[number] : last[number]]
        a, b, c = corners[number]
        area = _cross(b - a, c - a)
        second = _cross(points[near] - a, c - a) / area
        third = _cross(b - a, points[near] - a) / area
        weights = np.stack([1.0 - second - third, second, third], axis=1)
        over = weights.min(axis=1) >= _INSIDE
        if over.any():
            yield int(number), near[over], weights[over]


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
