# SPDX-License-Identifier: Apache-2.0
"""The merged collision set against the plain sums it stands for (see ``contact_sums``)."""

from __future__ import annotations

import ipctk
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.ipc.contact.collision_lists import EDGE_EDGE
from taccel_lab.ipc.contact.collisions import GUARD_FRACTION
from taccel_lab.scene import Ball, KinematicBody, TriangleMesh, box_mesh, sphere_mesh
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.state import initial_state
from tests.ipc.contact_sums import edge_pair_sum, face_areas, log_barrier, node_face_sum
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose, scene
from tests.verification.assembly import Assembly

DHAT, KAPPA = 4e-4, 1e5


def reference_energy(assembly: Assembly, x: np.ndarray) -> float:
    """Gel nodes measure the contact; nodes of the body and pairs of edges guard it."""
    model = assembly.model
    rest = model.rest_positions.numpy()[0]
    faces = model.surface.faces.numpy()
    soft, body = (faces[slice(*part.faces)] for part in model.bodies)
    area = model.surface.node_areas.numpy()[0]
    guard = GUARD_FRACTION * DHAT

    def nodes_against(surface: np.ndarray, others: np.ndarray, reach: float) -> float:
        return node_face_sum(x, surface, others, area[others], np.full(len(others), reach))

    total = nodes_against(body, np.unique(soft), DHAT)
    total += nodes_against(soft, np.unique(body), guard)
    return KAPPA * (total + edge_pair_sum(x, rest, soft, body, guard))


def set_down(
    shape: TriangleMesh, placed: np.ndarray, gap: float, seed: int
) -> tuple[Assembly, np.ndarray]:
    """A rough gel surface and a body whose lowest vertex is ``gap`` above its highest node."""
    mesh = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3), jitter=0.2, seed=seed)
    model = scene(mesh, KinematicBody(shape)).finalize()
    x = initial_state(model, everywhere(1, placed)).positions.numpy()
    soft = slice(0, mesh.node_count)
    x[0, soft, 2] += np.random.default_rng(seed).uniform(-0.5, 0, mesh.node_count) * DHAT
    lift = x[0, soft, 2].max() - x[0, mesh.node_count :, 2].min() + gap
    placed = placed + [0, 0, lift, 0, 0, 0, 0]
    x[0, mesh.node_count :, 2] += lift
    config = SolverConfig(dhat_m=DHAT, kappa_pa=KAPPA)
    return Assembly(model, config, everywhere(1, placed)), x


@pytest.mark.thorough
@settings(max_examples=8)
@given(
    seed=st.integers(0, 10_000),
    depth=st.floats(0, 0.7),
    radius=st.floats(0.3e-3, 1.5e-3),
    angle=st.floats(0, 180),
    gap=st.floats(0.01, 0.5),
)
def test_merged_set_has_the_energy_of_the_full_sum(
    seed: int, depth: float, radius: float, angle: float, gap: float
) -> None:
    shape = bumpy_body(seed, radius, depth)
    assembly, x = set_down(shape, pose(0, 0, 0, (1, 2, 3), angle), gap * DHAT, seed)
    expected = reference_energy(assembly, x[0])
    assert assembly.contact_energy(x)[0] == pytest.approx(expected, rel=1e-9, abs=1e-22)


def test_concave_and_open_surfaces_have_the_energy_of_the_full_sum() -> None:
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(5), indexing="ij"), -1).reshape(-1, 2)
    sheet = np.column_stack([(grid - 2) * 4e-4, rng.uniform(0, 0.5, 25) * DHAT])
    i, j = (a.ravel() for a in np.meshgrid(np.arange(4), np.arange(4), indexing="ij"))
    a = 5 * i + j
    faces = np.concatenate([np.stack([a, a + 1, a + 6], 1), np.stack([a, a + 6, a + 5], 1)])
    assembly, x = set_down(TriangleMesh(sheet, faces), pose(1e-4, 5e-5, 0), 0.1 * DHAT, 3)
    expected = reference_energy(assembly, x[0])
    assert expected > 0
    assert assembly.contact_energy(x)[0] == pytest.approx(expected, rel=1e-10)
    collisions = assembly.solver.collisions
    stiffness = collisions.of(0, collisions.stiffnesses)
    assert (stiffness < 0).any(), "a concave surface subtracts duplicates"


def test_a_node_meets_a_convex_body_once() -> None:
    assembly, x = set_down(sphere_mesh(1e-3, 3e-4), pose(0, 0, 0), 0.05 * DHAT, 1)
    assert assembly.collide(x) > 0
    c = assembly.solver.collisions
    kinds, stencils = c.of(0, c.kinds), c.of(0, c.stencils)
    node = stencils[kinds != EDGE_EDGE, 0]
    on_gel = node[node < assembly.model.soft_count]
    assert len(on_gel) > 0
    assert len(np.unique(on_gel)) == len(on_gel)


def test_the_nodes_of_a_surface_measure_a_ball_and_its_faces_guard() -> None:
    mesh = block_mesh((4, 4, 1), (2e-3, 2e-3, 1e-3), jitter=0.2)
    radius, gap = 3e-3, 0.2 * DHAT
    model = scene(mesh, KinematicBody(Ball(radius))).finalize()
    poses = everywhere(1, pose(1e-4, 2e-4, radius + gap))
    assembly = Assembly(model, SolverConfig(dhat_m=DHAT, kappa_pa=KAPPA), poses)
    x = initial_state(model, poses).positions.numpy()
    faces = model.surface.faces.numpy()
    on_gel = np.unique(faces)

    def total(distance: np.ndarray, weight: np.ndarray, reach: float) -> float:
        terms = [log_barrier(d - radius, reach) if d > radius else np.inf for d in distance]
        return float(np.dot(weight, terms))

    nodes = np.linalg.norm(x[0, on_gel] - poses[0, 0, :3], axis=1)
    guarded = np.array(
        [ipctk.point_triangle_distance(poses[0, 0, :3], *x[0, f]) ** 0.5 for f in faces]
    )
    guard = GUARD_FRACTION * DHAT
    contact = total(nodes, model.surface.node_areas.numpy()[0, on_gel], DHAT)
    expected = KAPPA * (contact + total(guarded, face_areas(x[0], faces), guard))
    assert contact > 0 and expected > KAPPA * contact
    assert assembly.contact_energy(x)[0] == pytest.approx(expected, rel=1e-10)
    in_reach = (nodes < radius + DHAT).sum() + (guarded < radius + guard).sum()
    assert assembly.collide(x) == int(in_reach) > 4


def test_environments_at_rest_are_left_alone() -> None:
    mesh = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
    model = scene(mesh, KinematicBody(box_mesh((1e-3, 1e-3, 1e-3))), env_count=2).finalize()
    poses = everywhere(2, pose(0, 0, 0.5e-3 + 0.3 * DHAT))
    assembly = Assembly(model, SolverConfig(dhat_m=DHAT), poses)
    x = initial_state(model, poses).positions.numpy()
    assembly.active.assign([1, 0])
    assembly.collide(x)
    counts = assembly.solver.collisions.counts.numpy()
    assert counts[0] > 0 and counts[1] == 0
