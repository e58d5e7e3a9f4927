# SPDX-License-Identifier: Apache-2.0
"""A flat gel under a flat plate without friction: the force must not lean nor be uneven."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.geometry import Region, TetMesh
from taccel_lab.scene import Element, KinematicBody, Material, Scene, SoftBody, TriangleMesh
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, everywhere, pose, scene
from tests.support.scene_steps import Stepped
from tests.support.variants import variants
from tests.verification.assembly import Assembly

DHAT = 2e-5


def uneven_plate(cells: int, size_m: float, seed: int) -> TriangleMesh:
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
    mesh = block_mesh((gel_cells, gel_cells, 1), (2e-3, 2e-3, 1e-3), jitter=0.25, seed=1)
    shift = np.random.default_rng(seed).uniform(-2e-4, 2e-4, 2)
    placed = everywhere(1, pose(*shift, gap * DHAT, (0, 0, 1), 17.0 * seed))
    plate = uneven_plate(plate_cells, 4e-3, seed)
    model = scene(mesh, KinematicBody(plate)).finalize()
    assembly = Assembly(model, SolverConfig(dhat_m=DHAT), placed)
    x = initial_state(model, placed).positions.numpy()
    force = -assembly.contact_gradient(x)[0, : mesh.node_count].sum(axis=0)
    assert force[2] < 0
    return float(np.linalg.norm(force[:2]) / -force[2])


@pytest.mark.thorough
@pytest.mark.parametrize("gap", variants([0.5], [0.41, 0.5, 0.9]))
def test_a_flat_patch_does_not_lean(gap: float) -> None:
    cases = [(12, 10), (24, 10), (10, 20), (31, 20)]
    ratios = np.array([leaning(*case, seed, gap) for case in cases for seed in range(4)])
    assert ratios.max() < 1e-12


def test_under_pressure_beyond_the_guard_it_leans_a_little() -> None:
    """At a gap within the guard's range, above two kappa, edge pairs act too."""
    ratios = np.array([leaning(24, 10, seed, 0.2) for seed in range(4)])
    assert 0 < ratios.mean() < 2e-3


def contact_areas(mesh: TetMesh) -> np.ndarray:
    """Third of the contact faces around each node [m^2]."""
    faces, x = mesh.faces[mesh.face_regions == int(Region.CONTACT)], mesh.nodes_m
    third = np.linalg.norm(np.cross(*(x[faces[:, k]] - x[faces[:, 0]] for k in (1, 2))), axis=1) / 6
    area = np.zeros(len(x))
    for corner in range(3):
        np.add.at(area, faces[:, corner], third)
    return area


@pytest.mark.parametrize(
    ("element", "gel_cells", "plate_cells", "depth"),
    [
        (Element.LINEAR, 6, 8, 3e-4),
        pytest.param(Element.LINEAR, 10, 20, 1e-4, marks=pytest.mark.slow),
        pytest.param(Element.LINEAR, 10, 8, 3e-4, marks=pytest.mark.slow),
        (Element.QUADRATIC, 5, 8, 1e-4),
    ],
)
def test_uniform_pressure(element: Element, gel_cells: int, plate_cells: int, depth: float) -> None:
    """Contact-pressure patch test: no contraction (nu = 0), a plate that does not match the gel."""
    straight = element is Element.LINEAR
    cells = (gel_cells, gel_cells, gel_cells // 2)
    mesh = block_mesh(cells, (2e-3, 2e-3, 1e-3), jitter=0.25 if straight else 0.2, seed=2)
    plate = KinematicBody(uneven_plate(plate_cells, 4e-3, 3))
    made = Scene(SoftBody(mesh, Material(1e5, 0.0), element=element), plate)
    start, end = (pose(1e-4, 0, z, (0, 0, 1), 17) for z in (2 * DHAT, -depth))
    run = Stepped(made, start, dhat_m=DHAT, relative_tolerance=1e-7 if straight else 1e-6)
    report = run.step(end)
    force = -run.contact(0)[:, 2]
    if straight:
        area = contact_areas(mesh)
        loaded = area > 0
        assert np.abs(force[~loaded]).max() < 1e-9 * force.sum()
    else:
        # The rest of the corners' share is what is left of the unevenness.
        area = run.model.surface.node_areas.numpy()[0, run.nodes(0)]
        loaded = (np.arange(len(force)) >= mesh.node_count) & (force > 0)
    pressure = force[loaded] / area[loaded]
    unevenness = np.sqrt(np.mean((pressure / pressure.mean() - 1) ** 2))
    assert unevenness < (1e-4 if straight else 0.01)
    if straight:
        # Neo-Hooke's law of a bar of Young's modulus 1e5 Pa, pressed by depth less the gap.
        stretch = 1 - (depth + report.min_distance_m[0]) / 1e-3
        assert pressure.mean() == pytest.approx(0.5e5 * (1 / stretch - stretch), rel=1e-3)
