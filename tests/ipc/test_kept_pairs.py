# SPDX-License-Identifier: Apache-2.0
"""Pairs that are kept hold every pair that a search would find."""

from __future__ import annotations

import numpy as np
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.broad_phase.kept_pairs import KeptPairs
from taccel_lab.ipc.gaps import edge_edge_distances, point_triangle_distances
from taccel_lab.model import Model
from taccel_lab.scene import KinematicBody
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, bumpy_body, pose, scene

MESH = block_mesh((3, 3, 1), (3e-3, 3e-3, 1e-3), jitter=0.2)
BODY = bumpy_body(2, 0.8e-3)
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
