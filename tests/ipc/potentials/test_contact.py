# SPDX-License-Identifier: Apache-2.0
"""Barrier energy of a collision set: all kinds of pairs against finite differences, and balance."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from taccel_lab.geometry import Region
from taccel_lab.ipc.collisions import EDGE_EDGE, POINT_EDGE, POINT_POINT, POINT_TRIANGLE
from taccel_lab.scene import Ball, KinematicBody, TriangleMesh, box_mesh
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose, scene
from tests.verification.assembly import Assembly, central_difference, coordinate_probe

EXACT, PSD = 0, 1
DHAT = 3e-4
STEP = 1e-8
MESH = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3), jitter=0.2, seed=4)

SPIKE = TriangleMesh(
    np.array([[0, 0, 0], [2e-4, 0, 1e-3], [-1e-4, 2e-4, 1e-3], [-1e-4, -2e-4, 1e-3]]),
    np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]),
)
# A shallow roof over the gel, concave from below: the gel sees four faces at once.
ROOF = TriangleMesh(
    np.array(
        [
            [0, 0, 1.4e-4],
            *([7e-4 * x, 7e-4 * y, 0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))),
        ]
    ),
    np.array([[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4]]),
)
# The node in the middle of the contact face: its nearest feature of the spike is the tip.
MIDDLE = MESH.nodes_m[MESH.region_nodes(Region.CONTACT)][4]

# Body and orientation; each is set down with a gap that is a fraction of dhat.
BODIES: dict[str, tuple[TriangleMesh | Ball, np.ndarray]] = {
    "concave": (bumpy_body(1, 0.8e-3), pose(1e-4, -2e-4, 0, (1, 2, 3), 40)),
    "dented": (bumpy_body(6, 1e-3, 0.6), pose(-2e-4, 1e-4, 0, (3, 1, -1), 75)),
    "corner": (box_mesh((1e-3, 1e-3, 1e-3)), pose(1e-4, 5e-5, 0, (1, 1.1, 0.1), 50)),
    "parallel edges": (box_mesh((1e-3, 0.8e-3, 1e-3)), pose(1e-4, 6.2e-4, 0, (1, 0.3, 0.5), 0.7)),
    "spike": (SPIKE, pose(MIDDLE[0] + 3e-5, MIDDLE[1] - 2e-5, 0)),
    "roof": (ROOF, pose(MIDDLE[0] - 4e-6, MIDDLE[1] + 5e-6, 0, (1, 0.2, 0), 1)),
    "ball": (Ball(1.5e-3), pose(2e-4, -1e-4, 0)),
}


@lru_cache
def probing_assembly(name: str) -> tuple[Assembly, np.ndarray, np.ndarray]:
    """Assembly with one environment a probe; positions [node_count, 3]; nodes to move."""
    shape, placed = BODIES[name]
    lowest = -1.5e-3
    if isinstance(shape, TriangleMesh):
        one = scene(MESH, KinematicBody(shape)).finalize()
        turned = initial_state(one, everywhere(1, placed)).positions.numpy()[0, MESH.node_count :]
        lowest = turned[:, 2].min()
    placed = placed + [0, 0, 0.05 * DHAT - lowest, 0, 0, 0, 0]
    body_count = 1 if isinstance(shape, Ball) else len(shape.vertices_m)
    nodes = np.arange(MESH.node_count + body_count)
    count = 6 * len(nodes)
    model = scene(MESH, KinematicBody(shape), env_count=count).finalize()
    poses = everywhere(count, placed)
    assembly = Assembly(model, SolverConfig(dhat_m=DHAT), poses)
    x = initial_state(model, poses).positions.numpy()[0]
    x[: MESH.node_count] += np.random.default_rng(0).uniform(-2e-5, 1e-5, (MESH.node_count, 3))
    return assembly, x, nodes


def collisions_of(assembly: Assembly, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Kinds, stiffnesses and whether the mollifier acts, of environment 0."""
    assembly.collide(np.repeat(x[None], assembly.model.env_count, axis=0))
    c = assembly.solver.collisions
    kinds, stiffness = c.of(0, c.kinds), c.of(0, c.stiffnesses)
    nodes, threshold = c.of(0, c.stencils), c.of(0, c.thresholds)
    cross = np.cross(x[nodes[:, 1]] - x[nodes[:, 0]], x[nodes[:, 3]] - x[nodes[:, 2]])
    return kinds, stiffness, (cross**2).sum(axis=1) < threshold


def test_the_cases_cover_every_kind_of_collision() -> None:
    seen: set[tuple[int, bool]] = set()
    lowest = 0.0
    for name in BODIES:
        assembly, x, _ = probing_assembly(name)
        kinds, stiffness, mollified = collisions_of(assembly, x)
        seen |= set(zip(kinds.tolist(), mollified.tolist(), strict=True))
        lowest = min(lowest, stiffness.min())
    assert seen == {
        (POINT_TRIANGLE, False),
        (POINT_EDGE, False),
        (POINT_POINT, False),
        (EDGE_EDGE, False),
        (EDGE_EDGE, True),
    }
    assert lowest < 0, "no subtracted duplicate of a concave surface among the cases"


@pytest.mark.parametrize("name", BODIES)
def test_gradient_is_the_derivative_of_the_energy(name: str) -> None:
    assembly, x, nodes = probing_assembly(name)
    probes = coordinate_probe(x, nodes, STEP)
    gradient = assembly.contact_gradient(np.repeat(x[None], len(probes), axis=0))[0]
    slope = central_difference(assembly.contact_energy(probes), STEP).reshape(-1, 3)
    assert np.abs(gradient).max() > 1e-4
    np.testing.assert_allclose(gradient, slope, atol=2e-6 * np.abs(gradient).max())


@pytest.mark.parametrize("name", BODIES)
def test_exact_matrix_is_the_derivative_of_the_gradient(name: str) -> None:
    assembly, x, nodes = probing_assembly(name)
    probes = coordinate_probe(x, nodes, STEP)
    free = assembly.free
    # Right-hand side: the force that a motion of the body adds.
    motion = np.zeros_like(x)
    motion[MESH.node_count :] = np.random.default_rng(1).normal(size=(len(x) - MESH.node_count, 3))
    many = (len(probes), 1, 1)
    matrix, rhs = assembly.contact_system(np.tile(x, many), EXACT, np.tile(motion, many))
    change = central_difference(assembly.contact_gradient(probes), STEP)
    change = change.reshape(len(x), 3, len(x), 3)[..., free, :]
    expected = change[free].reshape(matrix[0].shape)
    assert np.abs(expected).max() > 1
    np.testing.assert_allclose(matrix[0], expected, atol=2e-6 * np.abs(expected).max())
    expected_rhs = -np.einsum("ni,nifj->fj", motion, change)
    assert np.abs(expected_rhs).max() > 1
    np.testing.assert_allclose(rhs[0], expected_rhs, atol=2e-6 * np.abs(expected_rhs).max())


@pytest.mark.parametrize("name", BODIES)
def test_projected_matrix_is_positive(name: str) -> None:
    assembly, x, _ = probing_assembly(name)
    many = np.repeat(x[None], assembly.model.env_count, axis=0)
    exact = assembly.contact_system(many, EXACT)[0][0]
    projected = assembly.contact_system(many, PSD)[0][0]
    scale = np.abs(exact).max()
    assert np.linalg.eigvalsh(projected)[0] > -1e-12 * scale
    assert np.linalg.eigvalsh(projected)[-1] > 1e-2 * scale
    assert np.linalg.eigvalsh(exact)[0] < -1e-6 * scale, "the exact matrix needs no projection here"


@pytest.mark.parametrize("name", BODIES)
def test_forces_on_gel_and_body_balance(name: str) -> None:
    assembly, x, _ = probing_assembly(name)
    many = np.repeat(x[None], assembly.model.env_count, axis=0)
    gradient = assembly.contact_gradient(many)[0]
    scale = np.abs(gradient).sum()
    on_gel, on_body = gradient[: MESH.node_count], gradient[MESH.node_count :]
    assert np.linalg.norm(on_gel.sum(axis=0)) > 1e-3 * scale
    np.testing.assert_allclose(on_gel.sum(axis=0), -on_body.sum(axis=0), atol=1e-13 * scale)
    moment = np.cross(x, gradient).sum(axis=0)
    np.testing.assert_allclose(moment, 0, atol=1e-12 * scale * np.abs(x).max())


def test_nothing_beyond_dhat() -> None:
    assembly, x, _ = probing_assembly("ball")
    away = x + np.where(np.arange(len(x))[:, None] >= MESH.node_count, [0, 0, DHAT], [0, 0, 0])
    many = np.repeat(away[None], assembly.model.env_count, axis=0)
    assert assembly.contact_energy(many)[0] == 0
    assert not assembly.contact_gradient(many)[0].any()
