# SPDX-License-Identifier: Apache-2.0
"""Consistent nodal forces of body forces and tractions on linear and quadratic tets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.geometry.quadratic import TET_EDGES

Field = Callable[[np.ndarray], np.ndarray]
"""Vectors [n, 3] at points [n, 3] [m]."""


def tet_rule(order: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points [q, 4] and weights [q] of sum 1: Gauss-Legendre in collapsed cubes."""
    g, w = np.polynomial.legendre.leggauss(order)
    g, w = (g + 1) / 2, w / 2
    a, b, c = (v.ravel() for v in np.meshgrid(g, g, g, indexing="ij"))
    weight = np.einsum("i,j,k->ijk", w, w, w).ravel() * 6 * (1 - a) ** 2 * (1 - b)
    b, c = b * (1 - a), c * (1 - a) * (1 - b)
    return np.stack([1 - a - b - c, a, b, c], axis=1), weight


def face_rule(order: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points [q, 3] and weights [q] of sum 1 of a triangle."""
    g, w = np.polynomial.legendre.leggauss(order)
    g, w = (g + 1) / 2, w / 2
    a, b = (v.ravel() for v in np.meshgrid(g, g, indexing="ij"))
    weight = np.einsum("i,j->ij", w, w).ravel() * 2 * (1 - a)
    return np.stack([1 - a - b * (1 - a), a, b * (1 - a)], axis=1), weight


def shape_functions(point: np.ndarray, node_count: int) -> np.ndarray:
    """Values of the shape functions of a tet or triangle, linear or quadratic, at a point."""
    corners = len(point)
    if node_count == corners:
        return point
    edges = TET_EDGES if corners == 4 else ((0, 1), (1, 2), (2, 0))
    middles = [4 * point[i] * point[j] for i, j in edges]
    return np.array([*(point * (2 * point - 1)), *middles])


def body_load(mesh: TetMesh | QuadraticMesh, force_n_m3: Field) -> np.ndarray:
    """Nodal forces [N] of a force per volume, shape [node_count, 3]."""
    corners = mesh.nodes_m[mesh.tets[:, :4]]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    load = np.zeros((mesh.node_count, 3))
    for point, weight in zip(*tet_rule(), strict=True):
        here = np.einsum("k,tkd->td", point, corners)
        force = force_n_m3(here) * (weight * volumes)[:, None]
        for local, value in enumerate(shape_functions(point, mesh.tets.shape[1])):
            np.add.at(load, mesh.tets[:, local], value * force)
    return load


def whole_faces(mesh: TetMesh | QuadraticMesh) -> np.ndarray:
    """Boundary faces as elements: three corners, then, if quadratic, the middles 01, 12, 20."""
    if isinstance(mesh, TetMesh):
        return mesh.faces
    parts = mesh.faces.reshape(-1, 4, 3)
    columns = [parts[:, 0, 0], parts[:, 1, 1], parts[:, 2, 2]]
    return np.stack([*columns, parts[:, 3, 0], parts[:, 3, 1], parts[:, 3, 2]], axis=1)


def surface_load(
    mesh: TetMesh | QuadraticMesh, faces: np.ndarray, traction_pa: Field
) -> np.ndarray:
    """Nodal forces [N] of a traction on some of ``whole_faces``, shape [node_count, 3]."""
    corners = mesh.nodes_m[faces[:, :3]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 2
    load = np.zeros((mesh.node_count, 3))
    for point, weight in zip(*face_rule(), strict=True):
        here = np.einsum("k,fkd->fd", point, corners)
        force = traction_pa(here) * (weight * areas)[:, None]
        for local, value in enumerate(shape_functions(point, faces.shape[1])):
            np.add.at(load, faces[:, local], value * force)
    return load
