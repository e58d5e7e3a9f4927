# SPDX-License-Identifier: Apache-2.0
"""A flat gel under a flat plate without friction: how far the contact force leans sideways."""

from __future__ import annotations

import numpy as np

from taccel_lab.scene import KinematicBody, TriangleMesh
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.state import initial_state
from tests.verification.assembly import Assembly
from tests.verification.blocks import block_mesh, everywhere, pose, scene


def uneven_plate(cells: int, size_m: float, seed: int) -> TriangleMesh:
    """A flat sheet that faces down, triangulated at random."""
    grid = np.stack(np.meshgrid(*[np.arange(cells + 1)] * 2, indexing="ij"), -1).reshape(-1, 2)
    moves = np.random.default_rng(seed).uniform(-0.25, 0.25, grid.shape)
    moves[(grid == 0) | (grid == cells)] = 0
    vertices = np.column_stack([((grid + moves) / cells - 0.5) * size_m, np.zeros(len(grid))])
    i, j = (a.ravel() for a in np.meshgrid(*[np.arange(cells)] * 2, indexing="ij"))
    a = i * (cells + 1) + j
    n = cells + 2
    return TriangleMesh(
        vertices,
        np.concatenate([np.stack([a, a + 1, a + n], 1), np.stack([a, a + n, a + n - 1], 1)]),
    )


def leaning(plate_cells: int, gel_cells: int, seed: int, gap: float) -> float:
    """|tangential force| / normal force at a uniform gap of ``gap`` dhat."""
    dhat = 2e-5
    mesh = block_mesh((gel_cells, gel_cells, 1), (2e-3, 2e-3, 1e-3), jitter=0.25, seed=1)
    shift = np.random.default_rng(seed).uniform(-2e-4, 2e-4, 2)
    placed = everywhere(1, pose(*shift, gap * dhat, (0, 0, 1), 17.0 * seed))
    plate = uneven_plate(plate_cells, 4e-3, seed)
    model = scene(mesh, KinematicBody(plate)).finalize()
    assembly = Assembly(model, SolverConfig(dhat_m=dhat), placed)
    x = initial_state(model, placed).positions.numpy()
    force = -assembly.contact_gradient(x)[0, : mesh.node_count].sum(axis=0)
    assert force[2] < 0
    return float(np.linalg.norm(force[:2]) / -force[2])


def test_a_flat_patch_hardly_leans() -> None:
    """Duplicates of node-face pairs are merged, those of edge pairs are not: 0.7 % on average."""
    cases = [(12, 10), (24, 10), (10, 20), (31, 20)]
    ratios = np.array([leaning(*case, seed, 0.5) for case in cases for seed in range(4)])
    assert ratios.mean() < 0.010
    assert ratios.max() < 0.020
