# SPDX-License-Identifier: Apache-2.0
"""The merged collision set against the inclusion-exclusion sum it stands for, with ipctk distances.

1/2 sum_nodes A_x [sum_faces b(d) - sum_inner edges b(d) + sum_inner vertices b(d)]
+ 1/4 sum_edge pairs (A_a + A_b) m b(d)
"""

from __future__ import annotations

from collections import Counter

import ipctk
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.ipc.collisions import EDGE_EDGE
from taccel_lab.scene import Ball, KinematicBody, TriangleMesh, box_mesh, sphere_mesh
from taccel_lab.scene.primitives import unique_edges
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.state import initial_state
from tests.verification.assembly import Assembly
from tests.verification.blocks import block_mesh, bumpy_body, everywhere, pose, scene

DHAT, KAPPA = 4e-4, 1e5


def log_barrier(distance: float) -> float:
    """dhat g(d / dhat) [m]."""
    y = distance / DHAT
    return -DHAT * (y - 1) ** 2 * np.log(y) if y < 1 else 0.0


def areas(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    return 0.5 * np.linalg.norm(
        np.cross(*(x[faces[:, k]] - x[faces[:, 0]] for k in (1, 2))), axis=1
    )


def node_face_sum(
    x: np.ndarray, rest: np.ndarray, faces: np.ndarray, others: np.ndarray, node_area: np.ndarray
) -> float:
    """Energy of nodes ``others`` against a surface, without any merging."""
    uses = Counter(
        tuple(sorted(e)) for f in faces.tolist() for e in zip(f, f[1:] + f[:1], strict=True)
    )
    inner = [e for e, count in uses.items() if count == 2]
    rim = {v for e, count in uses.items() if count == 1 for v in e}
    total = 0.0
    for p in others:
        terms = sum(log_barrier(ipctk.point_triangle_distance(x[p], *x[f]) ** 0.5) for f in faces)
        terms -= sum(
            log_barrier(ipctk.point_edge_distance(x[p], *x[list(e)]) ** 0.5) for e in inner
        )
        terms += sum(
            log_barrier(float(np.linalg.norm(x[p] - x[v])))
            for v in np.unique(faces)
            if v not in rim
        )
        total += 0.5 * node_area[p] * terms
    return KAPPA * total


def edge_pair_sum(x: np.ndarray, rest: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
    """Energy of the edge pairs of two surfaces, from all pairs."""
    total = 0.0
    edge_area: dict[tuple[int, ...], float] = {}
    for faces in (first, second):
        for face, area in zip(faces.tolist(), areas(rest, faces), strict=True):
            for e in zip(face, face[1:] + face[:1], strict=True):
                key = tuple(sorted(e))
                edge_area[key] = edge_area.get(key, 0.0) + area / 3
    for a in map(tuple, unique_edges(first).tolist()):
        for b in map(tuple, unique_edges(second).tolist()):
            ends = [*x[list(a)], *x[list(b)]]
            value = log_barrier(ipctk.edge_edge_distance(*ends) ** 0.5)
            if value > 0:
                threshold = ipctk.edge_edge_mollifier_threshold(*rest[list(a)], *rest[list(b)])
                mollifier = ipctk.edge_edge_mollifier(*ends, threshold)
                total += 0.25 * (edge_area[a] + edge_area[b]) * mollifier * value
    return KAPPA * total


def reference_energy(assembly: Assembly, x: np.ndarray) -> float:
    model = assembly.model
    rest = model.rest_positions.numpy()[0]
    faces = model.surface.faces.numpy()
    soft, body = faces[: model.soft_faces[1]], faces[model.soft_faces[1] :]
    node_area = np.zeros(len(x))
    for part in (soft, body):
        np.add.at(node_area, part, areas(rest, part)[:, None] / 3)
    total = node_face_sum(x, rest, body, np.unique(soft), node_area)
    total += node_face_sum(x, rest, soft, np.unique(body), node_area)
    return total + edge_pair_sum(x, rest, soft, body)


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


@settings(max_examples=20)
@given(
    seed=st.integers(0, 10_000),
    depth=st.floats(0, 0.7),
    radius=st.floats(0.3e-3, 1.5e-3),
    angle=st.floats(0, 180),
    gap=st.floats(0.02, 0.6),
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
    count = int(assembly.solver.collisions.counts.numpy()[0])
    stiffness = assembly.solver.collisions.stiffnesses.numpy()[0, :count]
    assert (stiffness < 0).any(), "a concave surface subtracts duplicates"


def test_a_node_meets_a_convex_body_once() -> None:
    assembly, x = set_down(sphere_mesh(1e-3, 3e-4), pose(0, 0, 0), 0.05 * DHAT, 1)
    assert assembly.collide(x) > 0
    c = assembly.solver.collisions
    count = int(c.counts.numpy()[0])
    kinds, stencils = c.kinds.numpy()[0, :count], c.stencils.numpy()[0, :count]
    node = stencils[kinds != EDGE_EDGE, 0]
    on_gel = node[node < assembly.model.soft_count]
    assert len(on_gel) > 0
    assert len(np.unique(on_gel)) == len(on_gel)


def test_a_ball_meets_each_face_in_reach_with_its_area() -> None:
    mesh = block_mesh((4, 4, 1), (2e-3, 2e-3, 1e-3), jitter=0.2)
    radius, gap = 3e-3, 0.2 * DHAT
    model = scene(mesh, KinematicBody(Ball(radius))).finalize()
    poses = everywhere(1, pose(1e-4, 2e-4, radius + gap))
    assembly = Assembly(model, SolverConfig(dhat_m=DHAT, kappa_pa=KAPPA), poses)
    x = initial_state(model, poses).positions.numpy()
    faces = model.surface.faces.numpy()
    distance = np.array(
        [ipctk.point_triangle_distance(poses[0, 0, :3], *x[0, f]) ** 0.5 for f in faces]
    )
    weight = areas(x[0], faces)
    terms = [log_barrier(d - radius) if d > radius else np.inf for d in distance]
    expected = KAPPA * float(np.dot(weight, terms))
    assert expected > 0
    assert assembly.contact_energy(x)[0] == pytest.approx(expected, rel=1e-10)
    assert assembly.collide(x) == int((distance < radius + DHAT).sum()) > 4


def test_lists_grow_and_nothing_is_dropped() -> None:
    assembly, x = set_down(bumpy_body(1, 1e-3), pose(0, 0, 0), 0.05 * DHAT, 1)
    expected = assembly.contact_energy(x)[0]
    count = assembly.collide(x)
    collisions, candidates = assembly.solver.collisions, assembly.solver.candidates
    assert count > 8
    collisions._allocate(3)
    candidates._allocate(2, 2)
    assert assembly.collide(x) == count
    assert collisions.capacity >= count
    assert assembly.contact_energy(x)[0] == pytest.approx(expected, rel=1e-12)


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
