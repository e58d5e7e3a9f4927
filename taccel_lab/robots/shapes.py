# SPDX-License-Identifier: Apache-2.0
"""Collision shapes of links: described when a robot is read, made when a scene needs them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taccel_lab.bodies.mesh_checks import check_extent, check_surface
from taccel_lab.errors import InputError, naming
from taccel_lab.files.collada_file import SUFFIX, read_collada
from taccel_lab.files.triangle_file import read_triangle_file
from taccel_lab.scene import Ball, TriangleMesh, box_mesh, cylinder_mesh

LINK_EXTENT_M = (1e-5, 5.0)
"""Sizes of a link's mesh: one of 20 m was meant in millimetres."""


@dataclass(frozen=True)
class PrimitiveShape:
    """A box, ball or cylinder about the shape's origin, the last one's axis along z."""

    what: str
    """What it is, for people: "sphere r 5 mm"."""
    kind: str
    """One of ``box``, ``sphere`` and ``cylinder``."""
    sizes_m: tuple[float, ...]
    """Edges, the radius, or radius and length."""

    @classmethod
    def box(cls, size_m: tuple[float, float, float]) -> PrimitiveShape:
        """A box of 12 triangles."""
        size = " x ".join(f"{1e3 * edge:g}" for edge in size_m)
        return cls(f"box {size} mm", "box", size_m)

    @classmethod
    def sphere(cls, radius_m: float) -> PrimitiveShape:
        """A perfect ball."""
        return cls(f"sphere r {1e3 * radius_m:g} mm", "sphere", (radius_m,))

    @classmethod
    def cylinder(cls, radius_m: float, length_m: float) -> PrimitiveShape:
        """A cylinder, 64 triangles around."""
        what = f"cylinder r {1e3 * radius_m:g}, length {1e3 * length_m:g} mm"
        return cls(what, "cylinder", (radius_m, length_m))

    def surface(self) -> TriangleMesh | Ball:
        """What is touched, in the frame of the shape; InputError for a size out of range."""
        if self.kind == "sphere":
            return Ball(*self.sizes_m)
        if self.kind == "cylinder":
            radius, length = self.sizes_m
            return cylinder_mesh(radius, length)
        x, y, z = self.sizes_m
        return box_mesh((x, y, z))


@dataclass(frozen=True)
class MeshShape:
    """A triangle mesh in a file: STL, PLY, OBJ or Collada."""

    path: Path
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """File units times this are metres; of Collada its metres, as it names its unit."""
    hull: bool = False
    """Whether its convex hull is touched instead of its triangles."""
    as_drawn: bool = False
    """Whether ``up_axis`` of a Collada file is left out."""

    @property
    def what(self) -> str:
        """Name of the file, for people."""
        return self.path.name

    def surface(self) -> TriangleMesh:
        """Its triangles in the frame of the shape [m].

        Raises InputError for a file that cannot be read, and for triangles that no body can touch,
        such as a surface that crosses itself.
        """
        collada = self.path.suffix.lower() == SUFFIX
        if collada:
            points, faces = read_collada(self.path, self.as_drawn)
        else:
            points, faces = read_triangle_file(self.path)
        points = points * np.array(self.scale)
        with naming(self.path):
            check_extent(points, "its surface", LINK_EXTENT_M)
            if self.hull:
                return TriangleMesh(*convex_hull(points))
            if np.prod(self.scale) < 0:
                faces = faces[:, ::-1]
            check_touchable(points, faces)
        return TriangleMesh(points, faces)


@dataclass(frozen=True)
class SurfaceShape:
    """Triangles that are at hand, about the shape's origin."""

    mesh: TriangleMesh
    what: str = "mesh"
    """What they are, for people: "capsule r 5 mm"."""
    hull: bool = False
    """Whether their convex hull is touched instead."""

    def surface(self) -> TriangleMesh:
        """The triangles, or their hull; InputError for those that no body can touch."""
        if self.hull:
            return TriangleMesh(*convex_hull(self.mesh.vertices_m))
        check_touchable(self.mesh.vertices_m, self.mesh.faces)
        return self.mesh


Shape = PrimitiveShape | MeshShape | SurfaceShape


def check_touchable(points: np.ndarray, faces: np.ndarray) -> None:
    """Refuse triangles that no body can touch, such as a surface that crosses itself."""
    try:
        check_surface(points, faces, "its surface", closed=False)
    except InputError as error:
        raise InputError(f"{error}. Its convex hull can be touched: Robot.with_hulls") from None


@dataclass(frozen=True)
class CollisionShape:
    """What others touch of a link."""

    shape: Shape
    link_from_shape: np.ndarray
    """Where it is in the link, float64, [4, 4]."""

    def surface(self) -> tuple[TriangleMesh | Ball, np.ndarray]:
        """The surface, and the pose of its frame in the link [4, 4].

        Meshes are in the link's frame already; a ball is about its own origin.
        """
        made = self.shape.surface()
        if isinstance(made, Ball):
            return made, self.link_from_shape
        turn, shift = self.link_from_shape[:3, :3], self.link_from_shape[:3, 3]
        return TriangleMesh(made.vertices_m @ turn.T + shift, made.faces), np.eye(4)


def convex_hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [n, 3] and outward triangles [m, 3] of the convex hull of points [k, 3].

    Raises InputError for points that lie in a plane.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        raise InputError("its points lie in a plane: they enclose nothing") from None
    used, faces = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = points[used], faces.reshape(-1, 3)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("fk,fk->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, [0, 2, 1]]
    return vertices, faces
