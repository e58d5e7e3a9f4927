# SPDX-License-Identifier: Apache-2.0
"""Meshes of users: every fault is found with its ids, and good meshes pass."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.bodies.box_pairs import box_pairs
from taccel_lab.bodies.crossings import self_crossings
from taccel_lab.bodies.mesh_checks import check_surface, check_tets
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh, labelled
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.scene import (
    AffineBody,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TriangleMesh,
    box_mesh,
    cylinder_mesh,
    sphere_mesh,
)
from tests.support.blocks import bumpy_body
from tests.support.scene_steps import in_time
from tests.support.turns import random_turns

BALL = sphere_mesh(1e-3, 5e-4)
PAD = SoftBody(block_mesh((2, 2, 1), (8e-3, 8e-3, 2e-3)), Material(1e5, 0.4))
BLOCK = block_mesh((3, 3, 2), (3e-3, 3e-3, 2e-3), jitter=0.2)


def turned(points: np.ndarray, seed: int) -> np.ndarray:
    return points @ random_turns(seed, 1)[0].T + [0.3, -0.2, 0.1]


def check(vertices: np.ndarray, faces: np.ndarray, closed: bool = True) -> None:
    check_surface(vertices, np.asarray(faces), "part", closed=closed)


@pytest.mark.parametrize(
    "mesh",
    [
        box_mesh((1e-3, 2e-3, 3e-3)),
        cylinder_mesh(1e-3, 1e-3),
        BALL,
        *(bumpy_body(seed, 1e-3, 0.6) for seed in range(4)),
    ],
)
def test_good_surfaces_pass_in_any_frame(mesh: TriangleMesh) -> None:
    check(mesh.vertices_m, mesh.faces)
    for seed in range(3):
        check(turned(mesh.vertices_m, seed), mesh.faces)


def test_good_tets_pass_in_any_frame() -> None:
    """Coplanar neighbours must not count as crossings through rounding."""
    mesh = block_mesh((7, 6, 2), (8e-3, 8e-3, 3e-3), jitter=0.3)
    for seed in range(5):
        moved = TetMesh(turned(mesh.nodes_m, seed), mesh.tets, mesh.faces, mesh.face_regions)
        check_tets(moved, "gel")


def test_open_sheets_are_for_kinematic_bodies_only() -> None:
    faces = BALL.faces[1:]
    check(BALL.vertices_m, faces, closed=False)
    missing = BALL.faces[0]
    with pytest.raises(InputError, match=rf"not closed: 3 edges.*\({missing.min()}, "):
        check(BALL.vertices_m, faces)


def test_faults_of_surfaces_are_named() -> None:
    v, f = BALL.vertices_m, BALL.faces
    flipped, twin, flat = f.copy(), f.copy(), v.copy()
    flipped[7] = flipped[7, ::-1]
    row, corner = np.argwhere(f == 3)[0]
    twin[row, corner] = len(v)
    flat[f[5, 2]] = 0.3 * v[f[5, 0]] + 0.7 * v[f[5, 1]]
    above, (a, b) = np.vstack([v, [0.0, 0.0, 5e-3]]), f[0, :2]
    edge = rf"not manifold: 1 edges.*\({min(a, b)}, {max(a, b)}\)"
    for vertices, faces, closed, words in (
        (v, flipped, True, "oriented differently at 3 edges"),
        (above, np.vstack([f, [a, b, len(v)]]), False, edge),
        (v, np.vstack([f, [a, a, b]]), True, "1 faces name a vertex twice: faces 80"),
        (above, f, True, rf"1 vertices belong to no face: vertices {len(v)}"),
        (np.vstack([v, v[3] + 1e-14]), twin, True, rf"1 pairs of.*\(3, {len(v)}\); merge"),
        (flat, f, True, r"faces have no area to speak of: faces 5"),
    ):
        with pytest.raises(InputError, match=words):
            check(vertices, faces, closed)


def test_parts_that_meet_in_a_point_are_refused() -> None:
    other = BALL.vertices_m + [0, 0, 2.5e-3]
    faces = BALL.faces + len(other)
    faces[faces == len(other) + 2] = 4
    vertices = np.delete(np.vstack([BALL.vertices_m, other]), len(other) + 2, axis=0)
    faces[faces > len(other) + 2] -= 1
    with pytest.raises(InputError, match="1 vertices join parts that share no edge: vertices 4"):
        check(vertices, np.vstack([BALL.faces, faces]))


def test_faces_folded_onto_each_other_are_refused() -> None:
    v = np.array([[0, 0, 0], [1, 0, 0], [0.3, 1, 0], [0.6, 0.8, 0]]) * 1e-3
    with pytest.raises(InputError, match=r"1 pairs of faces lie on each other: faces \(0, 1\)"):
        check(v, [[0, 1, 2], [1, 0, 3]], closed=False)
    v[3, 2] = 1e-6
    check(v, [[0, 1, 2], [1, 0, 3]], closed=False)


def test_a_self_intersection_is_found_and_named() -> None:
    v = BALL.vertices_m.copy()
    pushed = int(v[:, 2].argmax())
    v[pushed, 2] -= 2.5e-3
    with pytest.raises(InputError, match=r"part intersects itself.*through faces"):
        check(v, BALL.faces)
    edges, faces = self_crossings(v, BALL.faces)
    assert (edges == pushed).any(axis=1).all() or (BALL.faces[faces] == pushed).any()
    with pytest.raises(InputError, match="the surface of gel intersects itself"):
        nodes = np.vstack([BLOCK.nodes_m, BLOCK.nodes_m + [1e-3, 0.2e-3, 0.3e-3]])
        tets = np.vstack([BLOCK.tets, BLOCK.tets + len(BLOCK.nodes_m)])
        check_tets(labelled(nodes, tets), "gel")


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), depth=st.floats(0.5, 3.0))
def test_self_intersections_agree_with_ipctk(seed: int, depth: float) -> None:
    import ipctk

    rng = np.random.default_rng(seed)
    v = BALL.vertices_m * (1 + rng.uniform(-0.3, 0.3, (len(BALL.vertices_m), 1)))
    v[rng.integers(len(v))] *= 1 - depth
    mesh = ipctk.CollisionMesh(v, ipctk.edges(BALL.faces), BALL.faces)
    assert (len(self_crossings(v, BALL.faces)[0]) > 0) == ipctk.has_intersections(mesh, v)


def test_faults_of_tets_are_named() -> None:
    nodes, tets, faces, regions = BLOCK.nodes_m, BLOCK.tets, BLOCK.faces, BLOCK.face_regions
    inward, one = faces.copy(), faces[np.zeros(len(faces), int)]
    inward[4] = inward[4, ::-1]
    lost = f"1 nodes belong to no tet: nodes {len(nodes)}"
    for mesh, words in (
        (TetMesh(np.vstack([nodes, [0, 0, 1.0]]), tets, faces, regions), lost),
        (TetMesh(nodes, tets, faces[1:], regions[1:]), f"has {len(one) - 1} faces, of which 0 are"),
        (TetMesh(nodes, tets, inward, regions), "of which 1 are not outward faces"),
        (TetMesh(nodes, tets, one, regions), f"and {len(one) - 1} are repeated"),
    ):
        with pytest.raises(InputError, match=words):
            check_tets(mesh, "gel")


def test_vertices_of_one_place_are_named() -> None:
    """Two balls above one another, and a third so far that FP32 does not tell their gap."""
    v, count = BALL.vertices_m, len(BALL.vertices_m)
    low, high = int(v[:, 2].argmin()), int(v[:, 2].argmax())
    faces = np.concatenate([BALL.faces + k * count for k in range(3)])

    def three(gap_m: float) -> np.ndarray:
        return np.concatenate([v, v + (v[high] - v[low]) + [0, 0, gap_m], v + [0, 0, 0.1]])

    check(three(1e-9), faces)
    words = rf"1 pairs of vertices lie at the same place: pairs \({high}, {count + low}\); merge"
    with pytest.raises(InputError, match=words):
        check(three(1e-11), faces)


def test_a_sliver_of_no_volume_and_overlapping_tets() -> None:
    nodes = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, 1e-12], [0.3, 0.3, 1.0]]) * 1e-2
    one = np.array([[0, 1, 2, 3]])
    with pytest.raises(InputError, match="1 tets have no volume to speak of: tets 0"):
        check_tets(TetMesh(nodes[:4], one, boundary_faces(one), np.zeros(4)), "gel")
    nodes[3, 2] = 5e-3
    two = np.array([[0, 1, 2, 3], [0, 1, 2, 4]])
    faces = boundary_faces(two)
    with pytest.raises(InputError, match=r"1 pairs of tets lie on the same side.*tets 0, 1"):
        check_tets(TetMesh(nodes, two, faces, np.zeros(len(faces))), "gel")


def test_bodies_in_millimetres_are_refused() -> None:
    gel = SoftBody(block_mesh((2, 2, 1), (8.0, 8.0, 2.0)), Material(1e5, 0.4))
    with pytest.raises(InputError, match=r"is 8 m across; at most 1 m .* 8 mm if its numbers are"):
        Scene(gel).finalize()
    box = box_mesh((0.06, 0.06, 0.02))
    shape = TriangleMesh(1e3 * box.vertices_m, box.faces)
    moving = Scene(PAD, affine_bodies=AffineBody(shape), time=in_time(1e-2, 0.0))
    for scene in (Scene(PAD, KinematicBody(shape)), moving):
        with pytest.raises(InputError, match=r"is 60 m across; at most 10 m .* 60 mm if"):
            scene.finalize()


@given(st.integers(0, 1000), st.integers(0, 30), st.integers(0, 30))
def test_box_pairs_are_those_of_brute_force(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (np.sort(rng.uniform(0, 1, (k, 2, 3)), axis=1) * [1, 1, 0.3] for k in (n, m))
    i, j = box_pairs((a[:, 0], a[:, 1]), (b[:, 0], b[:, 1]))
    overlap = (a[:, None, 0] <= b[None, :, 1]).all(-1) & (a[:, None, 1] >= b[None, :, 0]).all(-1)
    found = set(zip(i.tolist(), j.tolist(), strict=True))
    assert len(found) == len(i)
    # Boxes rounded to FP32 may add a pair that just does not touch, and never lose one.
    assert found >= {tuple(pair) for pair in np.argwhere(overlap).tolist()}
    assert len(found) <= overlap.sum() + 1


@pytest.mark.thorough
def test_the_time_of_a_check_grows_with_the_faces_and_not_with_their_pairs() -> None:
    """By a ratio: how fast this machine is, and what else it does, is in both times."""

    def least_s(spacing_m: float) -> tuple[int, float]:
        mesh = sphere_mesh(1e-2, spacing_m)
        times = []
        for _ in range(2):
            started = time.process_time()
            check(mesh.vertices_m, mesh.faces)
            times.append(time.process_time() - started)
        return len(mesh.faces), min(times)

    least_s(1.2e-3)
    (few, few_s), (many, many_s) = least_s(1.2e-3), least_s(3e-4)
    assert many > 12 * few and many > 13_000
    assert many_s / few_s < 2.5 * many / few
