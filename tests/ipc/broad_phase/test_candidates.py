# SPDX-License-Identifier: Apache-2.0
"""The broad phase against all pairs: no pair that comes within the margin may be missing.

Pairs that are kept hold every pair that a search would find.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import ipctk
import numpy as np
import pytest
import warp as wp
from hypothesis import example, given, settings
from hypothesis import strategies as st

from taccel_lab.benchmarks.measure import MemoryMeter
from taccel_lab.benchmarks.stress.gaps import closest_on_edges
from taccel_lab.bodies.crossings import point_triangle_distances
from taccel_lab.bodies.primitives import unique_edges
from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.broad_phase.kept_pairs import KeptPairs
from taccel_lab.ipc.device import ragged_lists
from taccel_lab.model import Model
from taccel_lab.model.kinematics import interpolate_poses
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody, Surface
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose, scene

MESH = block_mesh((3, 3, 1), (3e-3, 3e-3, 1e-3), jitter=0.2)
BODY, BALL = bumpy_body(2, 0.8e-3), Ball(0.7e-3)
Pairs = set[tuple[int, int]]


def tool(**options: Surface) -> KinematicBody:
    return KinematicBody(BODY, name="mesh", **options)


def search(
    model: Model,
    start: np.ndarray,
    margin: float,
    end: np.ndarray | None = None,
    displacement: np.ndarray | None = None,
    room: int = 64,
) -> Candidates:
    """Of a way between poses; nodes go by ``displacement``, with their bodies when None."""
    end = start if end is None else end
    x = initial_state(model, start).positions
    if displacement is None:
        displacement = initial_state(model, end).positions.numpy() - x.numpy()
    candidates = Candidates(model, room=room)
    everyone, way = wp.full(len(start), 1, dtype=wp.int32), wp.array(displacement, dtype=wp.vec3d)
    poses = (wp.array(part, dtype=wp.transformd) for part in (start, end))
    candidates.update(everyone, x, way, *poses, margin)
    return candidates


def found(candidates: Candidates, env: int = 0) -> list[Pairs]:
    lists = [part.of(env, part.pairs) for part in (candidates.node_faces, candidates.edge_edges)]
    pairs = [set(map(tuple, part.tolist())) for part in lists]
    assert [*map(len, pairs)] == [*map(len, lists)], "a pair came twice"
    return pairs


def near(a: np.ndarray, b: np.ndarray, margin: float, first: np.ndarray, second: int) -> Pairs:
    """Numbers of primitives with boxes within the margin, those of b counted from ``second``."""
    low_a, high_a, low_b, high_b = a.min(1), a.max(1), b.min(1), b.max(1)
    gaps = np.maximum(low_a[:, None] - high_b[None], low_b[None] - high_a[:, None]).max(axis=-1)
    return {(int(first[i]), int(second + j)) for i, j in np.argwhere(gaps < margin)}


def nearby(model: Model, x: np.ndarray, margin: float) -> tuple[Pairs, Pairs]:
    """Pairs whose boxes, in a frame where they are tight, are within the margin at positions x."""
    faces, edges = model.surface.faces.numpy(), model.surface.edges.numpy()
    gel, body, ball = model.bodies
    soft, body_faces = faces[slice(*gel.faces)], faces[slice(*body.faces)]
    nodes, vertices, centre = np.unique(soft), np.arange(*body.nodes), np.array([ball.nodes[0]])
    pairs = near(x[nodes][:, None], x[body_faces], margin, nodes, body.faces[0])
    pairs |= near(x[vertices][:, None], x[soft], margin, vertices, 0)
    pairs |= near(x[centre][:, None], x[soft], margin + BALL.radius_m, centre, 0)
    ours, theirs = (x[edges[slice(*part.edges)]] for part in (gel, body))
    return pairs, near(ours, theirs, margin, np.arange(len(ours)), body.edges[0])


@pytest.mark.thorough
@settings(max_examples=25)
@example(
    seed=5753, margin=0.00012563245055716122, turn=28.0, reach=0.000788563487232224, behind=False
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
    rng = np.random.default_rng(seed)
    model = scene(MESH, tool(), KinematicBody(BALL, name="ball")).finalize()
    start = everywhere(
        1,
        pose(*rng.uniform(-1e-3, 1e-3, 2), 0.9e-3, tuple(rng.normal(size=3)), 50),
        pose(*rng.uniform(-1e-3, 1e-3, 2), 0.8e-3),
    )
    if behind:
        start[..., 2] = -1e-3 - start[..., 2]
    end = start.copy()
    end[0, :, :3] += rng.uniform(-reach, reach, (2, 3))
    upside_down = pose(*end[0, 0, :3], tuple(rng.normal(size=3)), 180)
    turned = interpolate_poses(end, everywhere(1, upside_down, end[0, 1]), np.array([turn / 180]))
    end[0, 0] = turned[0, 0]
    x, target = (initial_state(model, part).positions.numpy() for part in (start, end))
    displacement = target - x
    displacement[0, : model.soft_count] = rng.uniform(-reach, reach, (model.soft_count, 3))
    displacement[0, MESH.bonded_nodes()] = 0.0
    cosines = np.abs(np.einsum("ebi,ebi->eb", start[..., 3:], end[..., 3:]))
    half = np.arccos(np.minimum(cosines, 1)).max()
    chord_error = model.kinematic_radii_m.max() * (1 - np.cos(half))
    node_face, edge_edge = found(search(model, start, margin + chord_error, end, displacement))
    faces, edges = model.surface.faces.numpy(), model.surface.edges.numpy()
    radii = model.surface.node_radii.numpy()
    for t in (0.0, 0.3, 0.7, 1.0):
        now = x[0] + t * displacement[0]
        near_faces, near_edges = nearby(model, now, margin)
        for n, f in near_faces - node_face:
            assert ipctk.point_triangle_distance(now[n], *now[faces[f]]) ** 0.5 - radii[n] >= margin
        for a, b in near_edges - edge_edge:
            assert ipctk.edge_edge_distance(*now[edges[a]], *now[edges[b]]) ** 0.5 >= margin


def test_pairs_far_away_are_left_out() -> None:
    model = scene(MESH, tool(), KinematicBody(BALL, name="ball")).finalize()
    gel = model.bodies[0]
    start = everywhere(1, pose(0, 0, 0.9e-3), pose(1e-3, 1e-3, 0.8e-3))
    node_face, edge_edge = found(search(model, start, 1e-4))
    soft_nodes = np.unique(model.surface.faces.numpy()[slice(*gel.faces)])
    all_pairs = len(soft_nodes) * len(BODY.faces) + len(BODY.vertices_m) * gel.faces[1]
    assert 0 < len(node_face) < 0.1 * all_pairs
    assert 0 < len(edge_edge) < 0.1 * len(unique_edges(BODY.faces)) * gel.edges[1]
    far = everywhere(1, pose(0, 0, 9e-3), pose(0, 0, 12e-3))
    assert found(search(model, far, 1e-4)) == [set(), set()]


def test_pairs_that_stay_apart_are_left_out_though_their_boxes_meet() -> None:
    rng, margin = np.random.default_rng(3), 5e-5
    model = scene(MESH, tool()).finalize()
    start, end = (everywhere(1, pose(x, 0, 0.5e-3, (1, 2, 3), 40)) for x in (0, 3e-3))
    x, ways = initial_state(model, start).positions.numpy()[0], np.zeros((model.node_count, 3))
    ways[: model.soft_count] = rng.uniform(-4e-5, 4e-5, (model.soft_count, 3))
    node_face, edge_edge = found(search(model, start, margin, end, ways[None] + [3e-3, 0, 0]))
    faces, edges = model.surface.faces.numpy(), model.surface.edges.numpy()

    def nearest(distance: Callable[..., float], first: np.ndarray, second: np.ndarray) -> float:
        """Distance that two primitives may come down to."""
        shift = ways[[*first, *second]].mean(axis=0)
        far = [np.linalg.norm(ways[part] - shift, axis=1).max() for part in (first, second)]
        return distance(*x[first], *x[second]) ** 0.5 - sum(far)

    of_faces = [
        nearest(ipctk.point_triangle_distance, np.array([n]), faces[f]) for n, f in node_face
    ]
    of_edges = [nearest(ipctk.edge_edge_distance, edges[a], edges[b]) for a, b in edge_edge]
    assert min(len(of_faces), len(of_edges)) > 5
    assert max(*of_faces, *of_edges) < 1.000001 * margin


def test_thickness_comes_on_top_of_the_margin() -> None:
    start = everywhere(1, pose(0, 0, 0.9e-3))
    pairs = []
    for thickness, margin in ((0.0, 1e-4), (5e-5, 5e-5), (0.0, 5e-5)):
        model = scene(MESH, tool(surface=Surface(thickness_m=thickness))).finalize()
        pairs.append(found(search(model, start, margin)))
    assert pairs[0] == pairs[1] != pairs[2]


def test_a_turn_in_one_environment_leaves_the_others_as_alone() -> None:
    """By 2 rad there is no bound on a path in the frame of a body, but one in space."""
    above = replace(MESH, nodes_m=MESH.nodes_m + [0, 0, 1.05e-3])
    gels = [
        SoftBody(mesh, Material(1e5, 0.4), name=name, element=Element.LINEAR)
        for mesh, name in ((MESH, "low"), (above, "high"))
    ]

    def turned(*angles: float) -> list[list[np.ndarray]]:
        model, place = Scene(gels, tool(), len(angles)).finalize(), (1.5e-3, 1.5e-3, 1.9e-3)
        end = np.stack([pose(*place, (1, 2, 3), np.degrees(angle))[None] for angle in angles])
        lists = search(model, everywhere(len(angles), pose(*place)), 1e-4, end, room=16).lists[:2]
        return [[np.array(part.of(e, part.pairs)) for part in lists] for e in range(len(angles))]

    together = turned(0.1, 2.0, 0.1, 0.0)
    assert len(together[1][1]) > 3 * len(together[0][1]) > 0
    for env, angle in ((0, 0.1), (2, 0.1), (3, 0.0)):
        for both, alone in zip(together[env], turned(angle)[0], strict=True):
            assert len(both) > 0
            np.testing.assert_array_equal(both, alone)


# Trees among gels ---------------------------------------------------------------------------------

MANY = 18
MARGIN = 1e-4


class Gels:
    """Two gels on mounts, face to face and each environment a little aside of the one before it."""

    def __init__(self) -> None:
        names = ("low", "high")
        gels = [
            SoftBody(MESH, Material(1e5, 0.4), name=n, mount=f"{n} mount", element=Element.LINEAR)
            for n in names
        ]
        mounts = [KinematicBody(None, name=f"{n} mount") for n in names]
        self.model = Scene(gels, mounts, MANY).finalize()
        self.candidates = Candidates(self.model)
        self.trees = self.candidates.lists[2]
        self.positions = np.zeros((MANY, self.model.node_count, 3))

    def search(self, *near: int) -> None:
        """With the gels of ``near`` within the margin, and 0.5 mm apart elsewhere."""
        gaps = np.where(np.isin(np.arange(MANY), near), 0.5 * MARGIN, 5 * MARGIN)
        above = [pose(5e-5 * env, 0, gap, (1, 0, 0), 180) for env, gap in enumerate(gaps)]
        state = initial_state(self.model, np.stack([[pose(0, 0, 0), high] for high in above]))
        everyone, still = wp.full(MANY, 1, dtype=wp.int32), wp.zeros_like(state.positions)
        path = (state.positions, still, state.poses, state.poses)
        self.candidates.update(everyone, *path, MARGIN)
        self.positions = state.positions.numpy()

    def listed(self, env: int) -> list[np.ndarray]:
        """Pairs of an environment in their order."""
        lists = (self.candidates.node_faces, self.candidates.edge_edges)
        return [part.of(env, part.pairs).copy() for part in lists]

    def nearest(self, env: int) -> list[Pairs]:
        """All pairs of both gels that are within the margin."""
        x, surface = self.positions[env], self.model.surface
        faces, edges, bodies = (
            array.numpy() for array in (surface.faces, surface.edges, surface.node_bodies)
        )
        nodes = np.unique(faces)
        n, f = np.nonzero(bodies[nodes][:, None] != bodies[faces[:, 0]])
        n = nodes[n]
        a, b = np.nonzero(bodies[edges[:, 0]][:, None] < bodies[edges[:, 0]])
        found = []
        for first, second, distances in (
            (n, f, point_triangle_distances(x[n], x[faces[f]])),
            (a, b, closest_on_edges(x[edges[a]], x[edges[b]])[2]),
        ):
            pairs = np.column_stack([first, second])[distances < MARGIN]
            found.append(set(map(tuple, pairs.tolist())))
        return found


def test_environments_whose_gels_come_near_each_other_have_trees() -> None:
    """Who comes later gets its own, and nothing changes elsewhere; the third of 18 is no
    exception any more, and all get them."""
    gels, near, before = Gels(), [], {}
    for env, held in ((5, [5]), (11, [5, 11]), (2, range(MANY))):
        near.append(env)
        gels.search(*near)
        assert np.flatnonzero(gels.trees.rooms).tolist() == list(held)
        # Trees to spare are those that the next ones get.
        assert len(held) <= gels.trees.capacity <= min(2 * len(held), MANY)
        for e in range(MANY):
            pairs = found(gels.candidates, e)
            assert pairs == (gels.nearest(e) if e in near else [set(), set()])
            assert e not in near or min(map(len, pairs)) > 10
        at_once = Gels()
        at_once.search(*near)
        for expected in (before, {e: at_once.listed(e) for e in near}):
            for e, pairs in expected.items():
                for one, other in zip(gels.listed(e), pairs, strict=True):
                    np.testing.assert_array_equal(one, other)
        before = {e: gels.listed(e) for e in near}


def test_trees_among_gels_take_the_memory_of_those_that_have_them() -> None:
    peaks = []
    for near in ([], [5], range(MANY)):
        with MemoryMeter() as meter:
            gels = Gels()
            gels.search(*near)
        peaks.append(meter.allocations().peak_bytes)
        assert (gels.trees.rooms[list(near)] == 1).all()
    # One is to spare.
    assert peaks[1] - peaks[0] < (peaks[2] - peaks[0]) * 2.2 / MANY


def test_one_of_two_gets_the_trees_that_there_is_memory_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    gels = Gels()

    def free(device: wp.Device) -> int:
        return (2 - gels.trees.capacity) * gels.trees.entry_bytes

    monkeypatch.setattr(ragged_lists, "free_memory", free)
    gels.search(5, 11)
    assert np.flatnonzero(gels.trees.rooms).tolist() == [11]
    assert found(gels.candidates, 11) == gels.nearest(11)
    assert found(gels.candidates, 5) == [set(), set()]


# Pairs that are kept ------------------------------------------------------------------------------

REACH = 1e-4
ENVS = 2


class Bench:
    """Environment 0 moves, environment 1 stays."""

    def __init__(self) -> None:
        self.model = scene(MESH, tool(), env_count=ENVS).finalize()
        self.state = initial_state(self.model, everywhere(ENVS, pose(0, 0, 0.95e-3)))
        self.candidates = Candidates(self.model)
        self.kept = KeptPairs(self.model, self.candidates, REACH)
        self.everyone = wp.full(ENVS, 1, dtype=wp.int32)
        self.reaches = wp.full(ENVS, REACH, dtype=wp.float64)
        self.searched = np.zeros(ENVS, dtype=int)
        self.near = 0

    def cover(self, gel: np.ndarray | float = 0.0, body: np.ndarray | float = 0.0) -> None:
        """In environment 0 gel and body go these ways [m]; numbers are along z."""
        gel, body = (np.array([0, 0, w]) if isinstance(w, float) else w for w in (gel, body))
        ways = np.zeros((ENVS, self.model.node_count, 3))
        ways[0, : self.model.soft_count], ways[0, self.model.soft_count :] = gel, body
        poses = self.state.poses.numpy()
        poses[0, 0, :3] += body
        ends, way = wp.array(poses, dtype=wp.transformd), wp.array(ways, dtype=wp.vec3d)
        path = [self.everyone, self.state.positions, way, self.state.poses, ends, self.reaches]

        def count() -> None:
            self.searched += self.kept.stale.numpy()

        self.kept.cover(*path, count)
        fresh = Candidates(self.model)
        fresh.search(*path)
        surface, x = self.model.surface, self.state.positions.numpy()
        faces, edges = surface.faces.numpy().reshape(-1, 3), surface.edges.numpy().reshape(-1, 2)
        mine = [found(self.candidates, env) for env in range(ENVS)]
        for env in range(ENVS):
            for k, part in enumerate(fresh.lists):
                pairs = part.of(env, part.pairs)
                least = np.full(len(pairs), np.inf)
                for t in np.linspace(0, 1, 11) if len(pairs) else ():
                    now, (first, second) = x[env] + t * ways[env], pairs.T
                    if k == 0:
                        distance = point_triangle_distances(now[first], now[faces[second]])
                    else:
                        distance = closest_on_edges(now[edges[first]], now[edges[second]])[2]
                    least = np.minimum(least, distance)
                assert {tuple(pair) for pair in pairs[least < REACH]} <= mine[env][k]
                self.near += int((least < REACH).sum())
        self.state.positions.assign(x + ways)
        wp.copy(self.state.poses, ends)


@pytest.mark.thorough
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 3e-4), st.floats(0, 1))
def test_no_pair_is_missing_on_any_way(seed: int, size: float, common: float) -> None:
    rng, bench = np.random.default_rng(seed), Bench()
    for _ in range(8):
        own = size * (1 - common) * rng.uniform(-1, 1, (bench.model.soft_count, 3))
        shared = size * common * rng.uniform(-1, 1, 3)
        bench.cover(own + shared, shared + size * (1 - common) * rng.uniform(-1, 1, 3))
    assert bench.searched[1] == 1, "who stays is searched once"
    assert bench.near > 0


def test_who_comes_nearer_is_seen_in_time() -> None:
    """From beyond the skin of the first search, which knew of no way, until it touches."""
    bench = Bench()
    bench.cover(body=5e-4)
    bench.cover()
    bench.kept.forget(bench.everyone)
    bench.cover()
    for _ in range(14):
        bench.cover(body=-4e-5)
    assert bench.near > 0 and 4 <= bench.searched[0] <= 10


def test_small_and_shared_ways_share_a_search_which_others_end() -> None:
    small, shared = Bench(), Bench()
    for _ in range(20):
        small.cover(1e-6)
    for _ in range(5):
        shared.cover(np.full(3, 2e-2), np.full(3, 2e-2))
    assert small.searched.tolist() == shared.searched.tolist() == [1, 1]
    # What others have written is searched anew.
    small.kept.forget(wp.array([0, 1], dtype=wp.int32))
    small.cover()
    assert small.searched.tolist() == [1, 2]
