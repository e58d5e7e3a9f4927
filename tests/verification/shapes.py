# SPDX-License-Identifier: Apache-2.0
"""Closed meshes for contact scenes: concave surfaces, tips and cracks, tets inside of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.block import grid_tets
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.scene import TriangleMesh

SIZE = 1e-2
"""Of the solids after Erleben [m]."""


def grid_faces(points: np.ndarray, close_rows: bool = False) -> np.ndarray:
    """Triangles of a grid [rows, columns], closed in columns; normals along rows x columns."""
    rows, columns = points.shape
    i, j = np.meshgrid(np.arange(rows if close_rows else rows - 1), np.arange(columns))
    i, j = i.ravel(), j.ravel()
    up, right = (i + 1) % rows, (j + 1) % columns
    a, b, c, d = points[i, j], points[up, j], points[up, right], points[i, right]
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def torus_mesh(radius_m: float, tube_m: float, around: int, across: int) -> TriangleMesh:
    u, v = np.meshgrid(
        np.arange(around) * (2 * np.pi / around),
        np.arange(across) * (2 * np.pi / across),
        indexing="ij",
    )
    away = radius_m + tube_m * np.cos(v)
    vertices = np.stack([away * np.cos(u), away * np.sin(u), tube_m * np.sin(v)], -1)
    index = np.arange(around * across).reshape(around, across)
    return TriangleMesh(vertices.reshape(-1, 3), grid_faces(index, close_rows=True))


def _thread(
    inner_m: float, outer_m: float, pitch_m: float, turns: float, segments: int
) -> np.ndarray:
    """Vertices [rows, segments, 3] of a right-handed V thread; its crests are rows of edges."""
    height = pitch_m / segments
    rows = round(turns * segments) + 1
    i, j = np.meshgrid(np.arange(rows), np.arange(segments), indexing="ij")
    phase = ((i - j) % segments) / segments
    radius = inner_m + (outer_m - inner_m) * np.abs(2 * phase - 1)
    angle = j * (2 * np.pi / segments)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height * i], -1)


def screw_mesh(
    inner_m: float, outer_m: float, pitch_m: float, turns: float, segments: int = 16
) -> TriangleMesh:
    side = _thread(inner_m, outer_m, pitch_m, turns, segments)
    rows = len(side)
    ends = np.array([[0, 0, 0], [0, 0, side[-1, 0, 2]]])
    index = np.arange(rows * segments).reshape(rows, segments)
    low, high = rows * segments, rows * segments + 1
    i, j = np.arange(segments), (np.arange(segments) + 1) % segments
    caps = [
        np.stack([index[0, j], index[0, i], np.full(segments, low)], 1),
        np.stack([index[-1, i], index[-1, j], np.full(segments, high)], 1),
    ]
    # Rows go up and columns around: the grid's normals point in.
    faces = np.concatenate([grid_faces(index)[:, ::-1], *caps])
    return TriangleMesh(np.concatenate([side.reshape(-1, 3), ends]), faces)


def nut_mesh(
    inner_m: float, outer_m: float, pitch_m: float, turns: float, wall_m: float, segments: int = 16
) -> TriangleMesh:
    """A nut around the rod's thread, its bore between two radii, ``wall_m`` its own radius."""
    bore = _thread(inner_m, outer_m, pitch_m, turns, segments)
    rows = len(bore)
    angle = np.arange(segments) * (2 * np.pi / segments)
    ring = np.column_stack([wall_m * np.cos(angle), wall_m * np.sin(angle), 0 * angle])
    outside = np.stack([ring, ring + [0, 0, bore[-1, 0, 2]]])
    inside = np.arange(rows * segments).reshape(rows, segments)
    shell = rows * segments + np.arange(2 * segments).reshape(2, segments)
    low = np.stack([shell[0], inside[0]])
    high = np.stack([inside[-1], shell[1]])
    faces = np.concatenate(
        [grid_faces(inside), grid_faces(shell)[:, ::-1], grid_faces(low), grid_faces(high)]
    )
    return TriangleMesh(np.concatenate([bore.reshape(-1, 3), outside.reshape(-1, 3)]), faces)


def extruded(
    profile: list[tuple[float, float]], triangles: list[tuple[int, int, int]]
) -> TriangleMesh:
    """A profile (y, z) counter-clockwise as seen against x, with its triangulation, along x."""
    flat = SIZE * np.array(profile)
    n = len(flat)
    ends = [np.column_stack([np.full(n, x), flat]) for x in (-SIZE / 2, SIZE / 2)]
    caps = np.array(triangles)
    a, b = np.arange(n), np.roll(np.arange(n), -1)
    sides = [np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)]
    return TriangleMesh(np.concatenate(ends), np.concatenate([caps[:, ::-1], caps + n, *sides]))


def roof(half_width_m: float, height_m: float, length_m: float) -> TriangleMesh:
    """A roof whose ridge lies along x at the origin, as sharp as it is slender."""
    x, y, z = length_m / 2, half_width_m, -height_m
    vertices = np.array([[-x, 0, 0], [x, 0, 0], [-x, -y, z], [x, -y, z], [-x, y, z], [x, y, z]])
    faces = [(0, 2, 3), (0, 3, 1), (0, 1, 5), (0, 5, 4), (2, 4, 5), (2, 5, 3), (0, 4, 2), (1, 3, 5)]
    return TriangleMesh(vertices, np.array(faces))


def pyramid(height: float) -> TriangleMesh:
    """A square base at z = 0 and an apex at ``height``; below zero it points down."""
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    base = np.array([(0.5 * x, 0.5 * y, 0) for x, y in corners])
    vertices = SIZE * np.concatenate([base, [[0, 0, height]]])
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    return TriangleMesh(vertices, faces if height > 0 else faces[:, ::-1])


def pit() -> TriangleMesh:
    """A block whose upper face, at z = 0, is a pyramid of one half pressed into it."""
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    top = [(0.5 * x, 0.5 * y, 0) for x, y in corners]
    bottom = [(0.5 * x, 0.5 * y, -1) for x, y in corners]
    vertices = SIZE * np.array([*top, *bottom, (0, 0, -0.5)])
    faces = [(0, 1, 8), (1, 2, 8), (2, 3, 8), (3, 0, 8), (4, 6, 5), (4, 7, 6)]
    for i in range(4):
        j = (i + 1) % 4
        faces += [(i, 4 + i, 4 + j), (i, 4 + j, j)]
    return TriangleMesh(vertices, np.array(faces))


def touchable(nodes_m: np.ndarray, tets: np.ndarray) -> TetMesh:
    faces = boundary_faces(tets)
    return TetMesh(nodes_m, tets, faces, np.full(len(faces), int(Region.SIDE)))


def filled(surface: TriangleMesh) -> TetMesh:
    """A tet from each triangle of a convex surface to the middle of its vertices."""
    vertices, faces = surface.vertices_m, surface.faces
    tets = np.column_stack([faces[:, [0, 2, 1]], np.full(len(faces), len(vertices))])
    return touchable(np.concatenate([vertices, [vertices.mean(axis=0)]]), tets)


def mapped_block(cells: tuple[int, int, int], shape: Callable[[np.ndarray], np.ndarray]) -> TetMesh:
    """The cube [-1, 1]^3 in cells, its nodes moved by ``shape`` ([n, 3] to [n, 3])."""
    axes = [np.linspace(-1, 1, n + 1) for n in cells]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return touchable(shape(nodes), grid_tets(*cells))


def ball_tets(radius_m: float, cells: int) -> TetMesh:

    def shape(nodes: np.ndarray) -> np.ndarray:
        # Shells of the cube become spheres; between them, evenly spread by angle.
        bent = np.tan(nodes * np.pi / 4)
        length = np.maximum(np.linalg.norm(bent, axis=1), 1e-30)
        return radius_m * bent * (np.abs(nodes).max(axis=1) / length)[:, None]

    return mapped_block((cells, cells, cells), shape)
