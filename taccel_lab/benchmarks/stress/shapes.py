# SPDX-License-Identifier: Apache-2.0
"""Sharp, thin and flat meshes: what a solver of contacts likes least. Lengths in metres."""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.block import block_mesh, grid_tets
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.model.embedding import rotate
from taccel_lab.scene import TriangleMesh, box_mesh, sphere_mesh


def pose(
    place: np.ndarray | tuple[float, float, float], turn: np.ndarray | None = None
) -> np.ndarray:
    """Position and quaternion as one pose, shape [7]."""
    return np.concatenate([place, (0, 0, 0, 1) if turn is None else turn]).astype(np.float64)


def about(axis: tuple[float, float, float] | np.ndarray, angle: float) -> np.ndarray:
    """Quaternion x, y, z, w of a turn by an angle [rad]."""
    unit = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    return np.append(np.sin(angle / 2) * unit, np.cos(angle / 2))


def after(second: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Quaternion of ``first`` followed by ``second``."""
    v2, w2, v1, w1 = second[:3], second[3], first[:3], first[3]
    return np.append(w2 * v1 + w1 * v2 + np.cross(v2, v1), w2 * w1 - v2 @ v1)


def reach(mesh: TriangleMesh | TetMesh, turn: np.ndarray) -> tuple[float, float]:
    """Lowest and highest point of a mesh that is turned [m]."""
    nodes = mesh.vertices_m if isinstance(mesh, TriangleMesh) else mesh.nodes_m
    z = rotate(turn, nodes)[:, 2]
    return float(z.min()), float(z.max())


# Stiff shapes ----------------------------------------------------------------------------------


def cone(radius: float, height: float, segments: int) -> TriangleMesh:
    """Its tip at the origin, pointing down; a needle when slender."""
    angle = np.arange(segments) * (2 * np.pi / segments)
    ring = np.column_stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.full(segments, height)]
    )
    tip, top = segments, segments + 1
    i, j = np.arange(segments), (np.arange(segments) + 1) % segments
    faces = np.concatenate(
        [np.stack([j, i, np.full(segments, tip)], 1), np.stack([i, j, np.full(segments, top)], 1)]
    )
    return TriangleMesh(np.concatenate([ring, [[0, 0, 0], [0, 0, height]]]), faces)


def wedge(half_width: float, height: float, length: float) -> TriangleMesh:
    """Its ridge along y at the origin, pointing down."""
    x, y, z = half_width, length / 2, height
    vertices = np.array([[0, -y, 0], [0, y, 0], [-x, -y, z], [-x, y, z], [x, -y, z], [x, y, z]])
    faces = [(0, 2, 3), (0, 3, 1), (0, 1, 5), (0, 5, 4), (2, 4, 5), (2, 5, 3), (0, 4, 2), (1, 3, 5)]
    return TriangleMesh(vertices, np.array(faces))


def torus(radius: float, tube: float, around: int = 12, across: int = 6) -> TriangleMesh:
    """A ring about z; ``tube`` is the radius of its section."""
    u, v = np.meshgrid(
        np.arange(around) * (2 * np.pi / around),
        np.arange(across) * (2 * np.pi / across),
        indexing="ij",
    )
    away = radius + tube * np.cos(v)
    vertices = np.stack([away * np.cos(u), away * np.sin(u), tube * np.sin(v)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    up, right = (i + 1) % around, (j + 1) % across
    a, b, c, d = (
        (first * across + second).ravel()
        for first, second in ((i, j), (up, j), (up, right), (i, right))
    )
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return TriangleMesh(vertices, faces)


STIFF_SHAPES = ("box", "sphere", "cone", "needle", "wedge", "plate", "ring", "bumps")


def stiff_shape(name: str, size: float, seed: int = 0) -> TriangleMesh:
    """A closed surface about its middle, about ``size`` across."""
    half = size / 2
    if name == "box":
        return box_mesh((size, size, size))
    if name == "sphere":
        return sphere_mesh(half, 0.7 * half)
    if name == "plate":
        return box_mesh((size, 0.8 * size, 0.04 * size))
    if name == "ring":
        return torus(0.35 * size, 0.15 * size)
    if name == "bumps":
        ball = sphere_mesh(half, 0.5 * half)
        scale = 1 + 0.3 * np.random.default_rng(seed).uniform(-1, 1, (len(ball.vertices_m), 1))
        return TriangleMesh(ball.vertices_m * scale, ball.faces)
    pointed = {
        "cone": cone(half, size, 10),
        "needle": cone(0.03 * size, size, 6),
        "wedge": wedge(0.3 * size, 0.7 * size, size),
    }[name]
    middle = 0.5 * (pointed.vertices_m.min(axis=0) + pointed.vertices_m.max(axis=0))
    return TriangleMesh(pointed.vertices_m - middle, pointed.faces)


# Soft shapes -----------------------------------------------------------------------------------


def touchable(nodes: np.ndarray, tets: np.ndarray) -> TetMesh:
    """A mesh nothing of which is glued to anything."""
    faces = boundary_faces(tets)
    return TetMesh(nodes, tets, faces, np.full(len(faces), int(Region.SIDE)))


def soft_box(
    cells: tuple[int, int, int],
    size: tuple[float, float, float],
    jitter: float = 0.0,
    seed: int = 0,
) -> TetMesh:
    """A free block about its middle."""
    mesh = block_mesh(cells, size, jitter, seed)
    return touchable(mesh.nodes_m + [0, 0, size[2] / 2], mesh.tets)


def soft_ball(radius: float, cells: int) -> TetMesh:
    """A ball of ``cells``^3 deformed cubes."""
    axis = np.linspace(-1, 1, cells + 1)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    bent = np.tan(nodes * np.pi / 4)
    length = np.maximum(np.linalg.norm(bent, axis=1), 1e-30)
    scale = np.abs(nodes).max(axis=1) / length
    return touchable(radius * bent * scale[:, None], grid_tets(cells, cells, cells))


def with_slivers(mesh: TetMesh, left: float, share: float, seed: int) -> TetMesh:
    """Nodes moved until a tet beside each has only ``left`` of its volume.

    Nodes of the surface move within its flat parts, so that triangles become flat as well; nodes of
    its edges and corners stay.
    """
    random = np.random.default_rng(seed)
    nodes, tets = mesh.nodes_m.copy(), mesh.tets
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    fixed = (nodes < low + 1e-9 * (high - low)) | (nodes > high - 1e-9 * (high - low))
    for node in np.flatnonzero(fixed.sum(axis=1) <= 1):
        if random.uniform() > share:
            continue
        direction = np.where(fixed[node], 0.0, random.normal(size=3))
        direction /= np.linalg.norm(direction)
        star = tets[(tets == node).any(axis=1)]
        here, moved = nodes.copy(), nodes.copy()
        moved[node] += direction * np.linalg.norm(high - low)
        before, beyond = _volumes(here[star]), _volumes(moved[star])
        shrinking = beyond < before
        furthest = (before[shrinking] / (before - beyond)[shrinking]).min()
        goal = here.copy()
        goal[node] += (1 - left) * furthest * direction * np.linalg.norm(high - low)
        # Tets that are flat for the checks of a scene would only test those.
        if (
            6 * _volumes(goal[star]).min()
            > 1e-8 * np.linalg.norm(high - low) ** 3 * len(tets) ** -1
        ):
            nodes = goal
    return TetMesh(nodes, tets, mesh.faces, mesh.face_regions)


def _volumes(corners: np.ndarray) -> np.ndarray:
    edges = corners[:, 1:] - corners[:, :1]
    return np.linalg.det(edges) / 6
