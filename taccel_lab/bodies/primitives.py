# SPDX-License-Identifier: Apache-2.0
"""Closed triangle meshes of simple indenters, in metres, outward oriented."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.guards import require_shape
from taccel_lab.typed import typed


@typed
@dataclass(frozen=True, repr=False)
class TriangleMesh:
    """A triangle surface in its body frame."""

    vertices_m: np.ndarray
    """Vertex positions [m], float64, shape [vertex_count, 3]."""
    faces: np.ndarray
    """Triangles, outward by the right-hand rule, int32, shape [face_count, 3]."""

    def __repr__(self) -> str:
        size = " x ".join(f"{1e3 * side:.4g}" for side in np.ptp(self.vertices_m, axis=0))
        return (
            f"TriangleMesh of {len(self.vertices_m)} vertices, {len(self.faces)} faces, {size} mm"
        )

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices_m, dtype=np.float64)
        faces = np.ascontiguousarray(self.faces, dtype=np.int32)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or len(vertices) < 3:
            raise InputError(f"a triangle mesh needs vertices [n, 3], got {vertices.shape}")
        if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
            raise InputError(f"a triangle mesh needs faces [n, 3], got {faces.shape}")
        if not np.isfinite(vertices).all():
            raise InputError("a triangle mesh holds NaN or infinite vertices")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError("a triangle mesh refers to vertices that do not exist")
        object.__setattr__(self, "vertices_m", vertices)
        object.__setattr__(self, "faces", faces)

    def edges(self) -> np.ndarray:
        """Unique edges, int32, shape [edge_count, 2]; smaller vertex index first."""
        return unique_edges(self.faces)


def checked_pose(name: str, value: np.ndarray, *shapes: tuple[int | str, ...]) -> np.ndarray:
    """Return poses, position [m] and unit quaternion x, y, z, w, as float64: one of the ``shapes``,
    [7] or [env_count, 7] where none is given.

    Raises:
        InputError: Another shape, or a quaternion of another length.
    """
    pose = np.array(value, dtype=np.float64)
    require_shape(name, pose, *(shapes or ((7,), ("env_count", 7))))
    # Of thousands of environments at each step: a tenth of the time of ``linalg.norm``.
    norm = np.sqrt(np.einsum("...i,...i->...", pose[..., 3:], pose[..., 3:]))
    if (np.abs(norm - 1) > 1e-6).any():
        raise InputError(f"quaternion (x, y, z, w) of {name} must have unit length, got {norm}")
    return pose


@typed
@dataclass(frozen=True)
class Ball:
    """A perfect sphere about its body frame's origin: smooth, and one distance per gel face."""

    radius_m: float

    def __post_init__(self) -> None:
        _require_length("ball radius", self.radius_m)


def unique_edges(faces: np.ndarray) -> np.ndarray:
    """Unique undirected edges of triangles, int32, shape [edge_count, 2]."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.unique(np.sort(pairs, axis=1), axis=0).astype(np.int32)


def _require_length(name: str, value_m: float) -> None:
    if not (np.isfinite(value_m) and 1e-5 <= value_m <= 1.0):
        raise InputError(f"{name} must lie between 0.01 mm and 1 m, got {value_m * 1e3:g} mm")


@typed
def sphere_mesh(radius_m: float, edge_m: float) -> TriangleMesh:
    """Make a sphere about the origin as a subdivided icosahedron with edges of about ``edge_m``.

    The vertices lie slightly outside the sphere and the face centres slightly inside, so that the
    polyhedron's mean radius is the sphere's: chords bias a contact by less than edge^2 / (24 r).
    """
    _require_length("sphere radius", radius_m)
    _require_length("sphere mesh edge", edge_m)
    golden = (1 + 5**0.5) / 2
    corners = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    vertices = np.array(
        corners + [(c, a, b) for a, b, c in corners] + [(b, c, a) for a, b, c in corners]
    )
    vertices = vertices / np.linalg.norm(vertices[0])
    # The icosahedron's faces are its 20 triples of mutually nearest corners.
    gap = np.linalg.norm(vertices[:, None] - vertices[None], axis=-1)
    near = (gap > 1e-9) & (gap < 1.1)
    faces = np.array(
        [
            (i, j, k)
            for i in range(12)
            for j in range(i + 1, 12)
            for k in range(j + 1, 12)
            if near[i, j] and near[j, k] and near[i, k]
        ]
    )
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, [0, 2, 1]]
    edge = 1.05146 * radius_m
    while edge > edge_m * 1.2:
        edges = unique_edges(faces)
        key = {(int(a), int(b)): len(vertices) + i for i, (a, b) in enumerate(edges)}
        middle = vertices[edges].sum(axis=1)
        vertices = np.concatenate(
            [vertices, middle / np.linalg.norm(middle, axis=1, keepdims=True)]
        )
        mid = np.array(
            [
                [key[min(f[i], f[j]), max(f[i], f[j])] for i, j in ((0, 1), (1, 2), (2, 0))]
                for f in faces.tolist()
            ]
        )
        faces = np.concatenate(
            [
                np.stack([faces[:, 0], mid[:, 0], mid[:, 2]], 1),
                np.stack([faces[:, 1], mid[:, 1], mid[:, 0]], 1),
                np.stack([faces[:, 2], mid[:, 2], mid[:, 1]], 1),
                mid,
            ]
        )
        edge /= 2
    # A chord of length e dips e^2/(6 r) at a triangle's centre; half of the mean dip goes outward.
    mean_dip = np.mean(1 - np.linalg.norm(vertices[faces].mean(axis=1), axis=1))
    return TriangleMesh(vertices * radius_m * (1 + 0.75 * mean_dip), faces)


@typed
def box_mesh(size_m: tuple[float, float, float]) -> TriangleMesh:
    """Make an axis-aligned box about the origin, 12 triangles."""
    for value in size_m:
        _require_length("box edge", value)
    half = np.asarray(size_m) / 2
    signs = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return TriangleMesh(signs * half, np.array(faces))


@typed
def cylinder_mesh(radius_m: float, height_m: float, segments: int = 64) -> TriangleMesh:
    """Make a flat-ended cylinder about the origin, axis along z; ends are fans of ``segments``."""
    _require_length("cylinder radius", radius_m)
    _require_length("cylinder height", height_m)
    if segments < 8:
        raise InputError(f"a cylinder needs at least 8 segments, got {segments}")
    angle = np.arange(segments) * (2 * np.pi / segments)
    ring = np.stack([np.cos(angle), np.sin(angle)], 1) * radius_m
    low = np.column_stack([ring, np.full(segments, -height_m / 2)])
    high = np.column_stack([ring, np.full(segments, height_m / 2)])
    centre = np.array([[0, 0, -height_m / 2], [0, 0, height_m / 2]])
    i = np.arange(segments)
    j = (i + 1) % segments
    n = segments
    faces = np.concatenate(
        [
            np.stack([i, j, j + n], 1),
            np.stack([i, j + n, i + n], 1),
            np.stack([j, i, np.full(n, 2 * n)], 1),
            np.stack([i + n, j + n, np.full(n, 2 * n + 1)], 1),
        ]
    )
    return TriangleMesh(np.concatenate([low, high, centre]), faces)
