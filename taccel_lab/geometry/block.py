# SPDX-License-Identifier: Apache-2.0
"""A box of tets, for tests, examples and first tries; pads of sensors come from ``cad``."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from taccel_lab.geometry.tet_mesh import Region, TetMesh, boundary_faces


def grid_tets(nx: int, ny: int, nz: int) -> np.ndarray:
    """Six tets around the diagonal of each cell (Kuhn); node = (i (ny + 1) + j) (nz + 1) + k."""
    i, j, k = np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij")
    corner = np.stack([i.ravel(), j.ravel(), k.ravel()], axis=1)
    tets = []
    for order in permutations(range(3)):
        path = [corner]
        for axis in order:
            path.append(path[-1] + np.eye(3, dtype=int)[axis])
        steps = np.diff(np.stack([p[0] for p in path]).astype(np.float64), axis=0)
        if np.linalg.det(steps) < 0:
            path[1], path[2] = path[2], path[1]
        tets.append(
            np.stack([(p[:, 0] * (ny + 1) + p[:, 1]) * (nz + 1) + p[:, 2] for p in path], 1)
        )
    return np.stack(tets, axis=1).reshape(-1, 4)


def block_mesh(
    cells: tuple[int, int, int],
    size_m: tuple[float, float, float],
    jitter: float = 0.0,
    seed: int = 0,
) -> TetMesh:
    """A box with its contact face at z = 0 about the origin and its bonded face below.

    ``jitter`` moves each node by up to that fraction of a cell, surface nodes within the surface.
    """
    axes = [np.linspace(0.0, 1.0, n + 1) for n in cells]
    unit = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    moves = np.random.default_rng(seed).uniform(-jitter, jitter, unit.shape) / np.array(cells)
    moves[(unit < 1e-9) | (unit > 1 - 1e-9)] = 0.0
    nodes = (unit + moves - np.array([0.5, 0.5, 1.0])) * np.array(size_m)
    return labelled(nodes, grid_tets(*cells))


def free_block(cells: tuple[int, int, int], size_m: float, jitter: float = 0.0) -> TetMesh:
    """A cube all of whose faces can touch something."""
    mesh = block_mesh(cells, (size_m, size_m, size_m), jitter)
    side = np.full(len(mesh.faces), int(Region.SIDE))
    return TetMesh(mesh.nodes_m, mesh.tets, mesh.faces, side)


def labelled(nodes_m: np.ndarray, tets: np.ndarray) -> TetMesh:
    """A mesh whose boundary at the largest z is contact, at the smallest z bond, else side."""
    faces = boundary_faces(tets)
    z = nodes_m[faces][..., 2]
    low, high = nodes_m[:, 2].min(), nodes_m[:, 2].max()
    near = 1e-9 * (high - low)
    region = np.full(len(faces), int(Region.SIDE))
    region[(z < low + near).all(axis=1)] = int(Region.BOND)
    region[(z > high - near).all(axis=1)] = int(Region.CONTACT)
    return TetMesh(nodes_m, tets, faces, region)
