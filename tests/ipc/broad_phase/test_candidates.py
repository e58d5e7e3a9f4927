# SPDX-License-Identifier: Apache-2.0
"""The broad phase against all pairs: no pair that comes within the margin may be missing.

Pairs that are kept hold every pair that a search would find.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from hypothesis import example, given, settings
from hypothesis import strategies as st

from taccel_lab.benchmarks.stress.gaps import edge_edge_distances
from taccel_lab.bodies.crossings import point_triangle_distances
from taccel_lab.bodies.primitives import unique_edges
from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.broad_phase.kept_pairs import KeptPairs
from taccel_lab.model import Model
from taccel_lab.model.kinematics import interpolate_poses
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody, Surface
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose, scene

MESH = block_mesh((3, 3, 1), (3e-3, 3e-3, 1e-3), jitter=0.2)
BODY = bumpy_body(2, 0.8e-3)
BALL = Ball(0.7e-3)


def build() -> Model:
    return scene(
        MESH, KinematicBody(BODY, name="mesh"), KinematicBody(BALL, name="ball")
    ).finalize()


def box_gaps(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Largest separation along an axis of the boxes of primitives [n, k, 3] and [m, k, 3]."""
    low_a, high_a, low_b, high_b = a.min(1), a.max(1), b.min(1), b.max(1)
    return np.maximum(low_a[:, None] - high_b[None], low_b[None] - high_a[:, None]).max(axis=-1)


def found(candidates: Candidates) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """Node-face and edge-edge pairs of environment 0."""
    faces, edges = (part.of(0, part.pairs) for part in candidates.lists)
    pairs = set(map(tuple, faces.tolist())), set(map(tuple, edges.tolist()))
    assert len(pairs[0]) == len(faces) and len(pairs[1]) == len(edges), "a pair came twice"
    return pairs


def nearby(model: Model, x: np.ndarray, margin: float) -> tuple[set, set]:
    """Pairs whose boxes, in a frame where they are tight, are within the margin at positions x."""
    faces, edges = model.surface.faces.numpy(), model.surface.edges.numpy()
    gel, body, ball = model.bodies
    soft, body_faces = faces[slice(*gel.faces)], faces[slice(*body.faces)]
    nodes = np.unique(soft)
    pairs = set()
    gaps = box_gaps(x[nodes][:, None], x[body_faces])
    pairs |= {(int(nodes[i]), int(body.faces[0] + j)) for i, j in np.argwhere(gaps < margin)}
    vertices = np.arange(*body.nodes)
    gaps = box_gaps(x[vertices][:, None], x[soft])
    pairs |= {(int(vertices[i]), int(j)) for i, j in np.argwhere(gaps < margin)}
    centre = ball.nodes[0]
    gaps = box_gaps(x[centre][None, None], x[soft])[0] - BALL.radius_m
    pairs |= {(centre, int(j)) for j in np.flatnonzero(gaps < margin)}
    gaps = box_gaps(x[edges[slice(*gel.edges)]], x[edges[slice(*body.edges)]])
    return pairs, {(int(i), int(body.edges[0] + j)) for i, j in np.argwhere(gaps < margin)}


def true_distances(model: Model, x: np.ndarray, pairs: set[tuple[int, int]]) -> dict:
    """Distance of node-face pairs less a ball's radius, by ipctk."""
    import ipctk

    faces, radii = model.surface.faces.numpy(), model.surface.node_radii.numpy()
    return {
        (n, f): ipctk.point_triangle_distance(x[n], *x[faces[f]]) ** 0.5 - radii[n]
        for n, f in pairs
    }


def edge_distances(model: Model, x: np.ndarray, pairs: set[tuple[int, int]]) -> dict:
    import ipctk

    edges = model.surface.edges.numpy()
    return {(a, b): ipctk.edge_edge_distance(*x[edges[a]], *x[edges[b]]) ** 0.5 for a, b in pairs}


@pytest.mark.thorough
@settings(max_examples=25)
@example(
    seed=5753,
    margin=0.00012563245055716122,
    turn=28.0,
    reach=0.000788563487232224,
    behind=False,
)
@example(seed=3, margin=5e-5, turn=20.0, reach=3e-4, behind=True)
@given(
    seed=st.integers(0, 10_000),
    margin=st.floats(1e-6, 5e-4),
    turn=st.floats(0, 60),
    reach=st.floats(0, 1e-3),
    behind=st.booleans(),
)
def test_no_pair_is_missed_on_the_way(
    seed: int, margin: float, turn: float, reach: float, behind: bool
) -> None:
    """From above the gel or from behind, where its nodes are held."""
    rng = np.random.default_rng(seed)
    model = build()
    start = everywhere(
        1,
        pose(*rng.uniform(-1e-3, 1e-3, 2), 0.9e-3, tuple(rng.normal(size=3)), 50),
        pose(*rng.uniform(-1e-3, 1e-3, 2), 0.8e-3),
    )
    if behind:
        start[..., 2] = -1e-3 - start[..., 2]
    end = start.copy()
    end[0, :, :3] += rng.uniform(-reach, reach, (2, 3))
    end[0, 0] = interpolate_poses(
        end,
        everywhere(1, pose(*end[0, 0, :3], tuple(rng.normal(size=3)), 180), end[0, 1]),
        np.array([turn / 180]),
    )[0, 0]
    x = initial_state(model, start).positions.numpy()
    target = initial_state(model, end).positions.numpy()
    displacement = target - x
    soft = slice(0, model.soft_count)
    displacement[0, soft] = rng.uniform(-reach, reach, (model.soft_count, 3))
    displacement[0, MESH.bonded_nodes()] = 0.0
    cosines = np.abs(np.einsum("ebi,ebi->eb", start[..., 3:], end[..., 3:]))
    angle = 2 * np.arccos(np.minimum(cosines, 1)).max()
    chord_error = model.kinematic_radii_m.max() * (1 - np.cos(angle / 2))

    candidates = Candidates(model, room=64)
    candidates.update(
        wp.array([1], dtype=wp.int32),
        wp.array(x, dtype=wp.vec3d),
        wp.array(displacement, dtype=wp.vec3d),
        wp.array(start, dtype=wp.transformd),
        wp.array(end, dtype=wp.transformd),
        margin + chord_error,
    )
    node_face, edge_edge = found(candidates)
    missed = []
    for t in (0.0, 0.3, 0.7, 1.0):
        now = x[0] + t * displacement[0]
        near_faces, near_edges = nearby(model, now, margin)
        close = true_distances(model, now, near_faces - node_face)
        missed += [pair for pair, d in close.items() if d < margin]
        close = edge_distances(model, now, near_edges - edge_edge)
        missed += [pair for pair, d in close.items() if d < margin]
    assert not missed


def test_pairs_far_away_are_left_out() -> None:
    model = build()
    start = everywhere(1, pose(0, 0, 0.9e-3), pose(1e-3, 1e-3, 0.8e-3))
    x = initial_state(model, start).positions
    still = wp.zeros_like(x)
    poses = wp.array(start, dtype=wp.transformd)
    candidates = Candidates(model)
    candidates.update(wp.array([1], dtype=wp.int32), x, still, poses, poses, 1e-4)
    node_face, edge_edge = found(candidates)
    gel = model.bodies[0]
    soft_nodes = np.unique(model.surface.faces.numpy()[slice(*gel.faces)])
    all_pairs = len(soft_nodes) * len(BODY.faces) + len(BODY.vertices_m) * gel.faces[1]
    assert 0 < len(node_face) < 0.1 * all_pairs
    assert 0 < len(edge_edge) < 0.1 * len(unique_edges(BODY.faces)) * gel.edges[1]
    far = everywhere(1, pose(0, 0, 9e-3), pose(0, 0, 12e-3))
    y = initial_state(model, far).positions
    away = wp.array(far, dtype=wp.transformd)
    candidates.update(wp.array([1], dtype=wp.int32), y, still, away, away, 1e-4)
    assert [part.counts.numpy()[0] for part in candidates.lists] == [0, 0]


def test_thickness_comes_on_top_of_the_margin() -> None:
    start = everywhere(1, pose(0, 0, 0.9e-3))
    pairs = []
    for thickness, margin in ((0.0, 1e-4), (5e-5, 5e-5), (0.0, 5e-5)):
        tool = KinematicBody(BODY, name="mesh", surface=Surface(thickness_m=thickness))
        model = scene(MESH, tool).finalize()
        x, poses = initial_state(model, start).positions, wp.array(start, dtype=wp.transformd)
        candidates = Candidates(model)
        active = wp.array([1], dtype=wp.int32)
        candidates.update(active, x, wp.zeros_like(x), poses, poses, margin)
        pairs.append(found(candidates))
    assert pairs[0] == pairs[1] != pairs[2]


def test_a_turn_in_one_environment_leaves_the_others_as_alone() -> None:
    """By 2 rad there is no bound on the path of a body in the frame of another: everything is a
    candidate, where it turns. The gels may touch each other, too."""

    def search(turns: list[float]) -> list[list[np.ndarray]]:
        """Pairs of faces and of edges in each environment."""
        above = replace(MESH, nodes_m=MESH.nodes_m + [0, 0, 1.05e-3])
        gels = [
            SoftBody(mesh, Material(1e5, 0.4), name=name, element=Element.LINEAR)
            for mesh, name in ((MESH, "low"), (above, "high"))
        ]
        model = Scene(gels, KinematicBody(BODY, name="mesh"), len(turns)).finalize()
        start = everywhere(len(turns), pose(1.5e-3, 1.5e-3, 1.9e-3))
        end = np.stack(
            [pose(1.5e-3, 1.5e-3, 1.9e-3, (1, 2, 3), np.degrees(turn))[None] for turn in turns]
        )
        x = initial_state(model, start).positions
        way = initial_state(model, end).positions.numpy() - x.numpy()
        candidates = Candidates(model, room=16)
        candidates.update(
            wp.full(len(turns), 1, dtype=wp.int32),
            x,
            wp.array(way, dtype=wp.vec3d),
            wp.array(start, dtype=wp.transformd),
            wp.array(end, dtype=wp.transformd),
            1e-4,
        )
        return [
            [np.array(part.of(env, part.pairs)) for part in candidates.lists]
            for env in range(len(turns))
        ]

    together = search([0.1, 2.0, 0.1, 0.0])
    assert len(together[1][1]) > 20 * len(together[0][1]) > 0
    for env, turn in ((0, 0.1), (2, 0.1), (3, 0.0)):
        (alone,) = search([turn])
        for found, expected in zip(together[env], alone, strict=True):
            assert len(found) > 0
            np.testing.assert_array_equal(found, expected)


REACH = 1e-4
ENVS = 2


class Bench:
    """Environment 0 moves, environment 1 stays."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.state = initial_state(model, np.array([[pose(0, 0, 0.95e-3)]] * ENVS))
        self.candidates = Candidates(model)
        self.kept = KeptPairs(model, self.candidates, REACH)
        self.everyone = wp.full(ENVS, 1, dtype=wp.int32)
        self.reaches = wp.full(ENVS, REACH, dtype=wp.float64)
        self.searched = np.zeros(ENVS, dtype=int)
        self.faces = model.surface.faces.numpy().reshape(-1, 3)
        self.edges = model.surface.edges.numpy().reshape(-1, 2)
        self.near = 0
        """Pairs within reach so far."""

    def nearest(
        self, env: int, pairs: np.ndarray, corners: np.ndarray, way: np.ndarray
    ) -> np.ndarray:
        """Least distance of each pair at eleven places of the way [m]."""
        least = np.full(len(pairs), np.inf)
        for part in np.linspace(0, 1, 11) if len(pairs) else ():
            x = self.state.positions.numpy()[env] + part * way
            if corners is self.faces:
                distance = point_triangle_distances(x[pairs[:, 0]], x[corners[pairs[:, 1]]])
            else:
                distance = edge_edge_distances(x[corners[pairs[:, 0]]], x[corners[pairs[:, 1]]])
            least = np.minimum(least, distance)
        return least

    def cover(self, gel: np.ndarray, body: np.ndarray) -> None:
        """In environment 0 the nodes of the gel go ``gel`` [m], [soft_count, 3], and the body goes
        ``body`` [m], [3]."""
        way = np.zeros((self.model.node_count, 3))
        way[: self.model.soft_count], way[self.model.soft_count :] = gel, body
        ways = wp.array(np.stack([way, 0 * way]), dtype=wp.vec3d)
        poses = self.state.poses.numpy()
        poses[0, 0, :3] += body
        ends = wp.array(poses, dtype=wp.transformd)
        path = [self.everyone, self.state.positions, ways, self.state.poses, ends]

        def count() -> None:
            self.searched += self.kept.stale.numpy()

        self.kept.cover(*path, self.reaches, count)
        fresh = Candidates(self.model)
        fresh.search(*path, self.reaches)
        lists = zip(self.candidates.lists, fresh.lists, (self.faces, self.edges), strict=True)
        for mine, searched, corners in lists:
            for env in range(ENVS):
                pairs = searched.of(env, searched.pairs)
                near = pairs[self.nearest(env, pairs, corners, ways.numpy()[env]) < REACH]
                listed = {tuple(pair) for pair in mine.of(env, mine.pairs)}
                assert {tuple(pair) for pair in near} <= listed
                self.near += len(near)
        moved = self.state.positions.numpy()
        moved[0] += way
        self.state.positions.assign(moved)
        wp.copy(self.state.poses, ends)


def make() -> Bench:
    return Bench(scene(MESH, KinematicBody(BODY, name="mesh"), env_count=ENVS).finalize())


@pytest.mark.thorough
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 3e-4), st.floats(0, 1))
def test_no_pair_is_missing_on_any_way(seed: int, size: float, common: float) -> None:
    rng, bench = np.random.default_rng(seed), make()
    for _ in range(8):
        own = size * (1 - common) * rng.uniform(-1, 1, (bench.model.soft_count, 3))
        shared = size * common * rng.uniform(-1, 1, 3)
        bench.cover(own + shared, shared + size * (1 - common) * rng.uniform(-1, 1, 3))
    assert bench.searched[1] == 1, "who stays is searched once"
    assert bench.near > 0


def test_who_comes_nearer_is_seen_in_time() -> None:
    """From beyond the skin of the first search, which knew of no way, until it touches."""
    bench = make()
    bench.cover(np.zeros(3), np.array([0, 0, 5e-4]))
    bench.cover(np.zeros(3), np.zeros(3))
    bench.kept.forget(bench.everyone)
    bench.cover(np.zeros(3), np.zeros(3))
    for _ in range(14):
        bench.cover(np.zeros(3), np.array([0, 0, -4e-5]))
    assert bench.near > 0
    assert 4 <= bench.searched[0] <= 10


def test_small_ways_share_a_search() -> None:
    bench = make()
    for _ in range(20):
        bench.cover(np.array([0, 0, 1e-6]), np.zeros(3))
    assert bench.searched[0] == 1


def test_a_motion_that_all_share_needs_no_search() -> None:
    bench = make()
    for _ in range(5):
        bench.cover(np.full(3, 2e-2), np.full(3, 2e-2))
    assert bench.searched[0] == 1


def test_what_others_have_written_is_searched_anew() -> None:
    bench = make()
    bench.cover(np.zeros(3), np.zeros(3))
    bench.kept.forget(wp.array([0, 1], dtype=wp.int32))
    bench.cover(np.zeros(3), np.zeros(3))
    np.testing.assert_array_equal(bench.searched, [1, 2])
