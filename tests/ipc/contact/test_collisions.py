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
from taccel_lab.solvers import SolverConfig
from taccel_lab.state import initial_state
from tests.ipc.contact_sums import face_areas, log_barrier, plain_sum
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose, scene
from tests.verification.assembly import Assembly

DHAT, KAPPA = 4e-4, 1e5
CONFIG = SolverConfig(dhat_m=DHAT, kappa_pa=KAPPA)


def set_down(
    shape: TriangleMesh, placed: np.ndarray, gap: float, seed: int
) -> tuple[Assembly, np.ndarray]:
    """A rough gel surface and a body whose lowest vertex is ``gap`` above its highest node."""
    mesh = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3), jitter=0.2, seed=seed)
    model = scene(mesh, KinematicBody(shape)).finalize()
    x = initial_state(model, everywhere(1, placed)).positions.numpy()
    soft, body = x[0, : mesh.node_count, 2], x[0, mesh.node_count :, 2]
    soft += np.random.default_rng(seed).uniform(-0.5, 0, mesh.node_count) * DHAT
    lift = soft.max() - body.min() + gap
    body += lift
    return Assembly(model, CONFIG, everywhere(1, placed + [0, 0, lift, 0, 0, 0, 0])), x


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
    expected = KAPPA * plain_sum(assembly.model, x[0], DHAT)
    assert assembly.contact_energy(x)[0] == pytest.approx(expected, rel=1e-9, abs=1e-22)


def test_concave_and_open_surfaces_have_the_energy_of_the_full_sum() -> None:
    grid = np.indices((5, 5)).reshape(2, -1).T
    heights = np.random.default_rng(3).uniform(0, 0.5, 25) * DHAT
    a = (5 * np.arange(4)[:, None] + np.arange(4)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + 6], 1), np.stack([a, a + 6, a + 5], 1)])
    sheet = TriangleMesh(np.column_stack([(grid - 2) * 4e-4, heights]), faces)
    assembly, x = set_down(sheet, pose(1e-4, 5e-5, 0), 0.1 * DHAT, 3)
    expected = KAPPA * plain_sum(assembly.model, x[0], DHAT)
    assert expected > 0 and assembly.contact_energy(x)[0] == pytest.approx(expected, rel=1e-10)
    stiffnesses = assembly.solver.collisions.snapshot(0)["stiffnesses"]
    assert (stiffnesses < 0).any(), "a concave surface subtracts duplicates"


def test_a_node_meets_a_convex_body_once() -> None:
    assembly, x = set_down(sphere_mesh(1e-3, 3e-4), pose(0, 0, 0), 0.05 * DHAT, 1)
    assert assembly.collide(x) > 0
    found = assembly.solver.collisions.snapshot(0)
    node = found["stencils"][found["kinds"] != EDGE_EDGE, 0]
    on_gel = node[node < assembly.model.soft_count]
    assert len(np.unique(on_gel)) == len(on_gel) > 0


def test_the_nodes_of_a_surface_measure_a_ball_and_its_faces_guard() -> None:
    mesh = block_mesh((4, 4, 1), (2e-3, 2e-3, 1e-3), jitter=0.2)
    radius, gap, guard = 3e-3, 0.2 * DHAT, GUARD_FRACTION * DHAT
    model = scene(mesh, KinematicBody(Ball(radius))).finalize()
    poses = everywhere(1, pose(1e-4, 2e-4, radius + gap))
    assembly = Assembly(model, CONFIG, poses)
    x = initial_state(model, poses).positions.numpy()
    faces, centre = model.surface.faces.numpy(), poses[0, 0, :3]
    on_gel = np.unique(faces)
    nodes = np.linalg.norm(x[0, on_gel] - centre, axis=1) - radius
    guarded = np.array([ipctk.point_triangle_distance(centre, *x[0, f]) ** 0.5 for f in faces])
    guarded -= radius
    assert min(nodes.min(), guarded.min()) > 0
    areas = model.surface.node_areas.numpy()[0, on_gel], face_areas(x[0], faces)
    contact = areas[0] @ [log_barrier(d, DHAT) for d in nodes]
    expected = contact + areas[1] @ [log_barrier(d, guard) for d in guarded]
    assert expected > contact > 0
    assert assembly.contact_energy(x)[0] == pytest.approx(KAPPA * expected, rel=1e-10)
    assert assembly.collide(x) == (nodes < DHAT).sum() + (guarded < guard).sum() > 4


def test_environments_at_rest_are_left_alone() -> None:
    mesh = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
    model = scene(mesh, KinematicBody(box_mesh((1e-3, 1e-3, 1e-3))), env_count=2).finalize()
    poses = everywhere(2, pose(0, 0, 0.5e-3 + 0.3 * DHAT))
    assembly = Assembly(model, SolverConfig(dhat_m=DHAT), poses)
    assembly.active.assign([1, 0])
    assembly.collide(initial_state(model, poses).positions.numpy())
    counts = assembly.solver.collisions.counts.numpy()
    assert counts[0] > 0 and counts[1] == 0
