# SPDX-License-Identifier: Apache-2.0
"""Continuous collision detection: never late, rarely early, against exact and ipctk queries.

Degenerate queries are after those of Wang et al. (2021), A Large-scale Benchmark and an Inclusion-
based Algorithm for Continuous Collision Detection, and Erleben (2018).
"""

from __future__ import annotations

from collections.abc import Callable

import ipctk
import numpy as np
import pytest

from taccel_lab.ipc.distance.ccd import (
    CCD_CAPPED,
    CCD_HIT,
    CCD_NO_HIT,
    CCD_START,
)
from tests.ipc.batch import (
    EDGE_EDGE,
    PLANE,
    POINT_TRIANGLE,
    Array,
    collide,
    query_pairs,
    unit,
)
from tests.ipc.exact import earliest_contact

NAMES = ("point_triangle", "edge_edge")
both_kinds = pytest.mark.parametrize("kind", (POINT_TRIANGLE, EDGE_EDGE), ids=NAMES)


def colliding(kind: int, seed: int, count: int) -> tuple[Array, Array, Array]:
    """Stencils, displacements and a time at which they touch in exact arithmetic.

    Everything is a dyadic rational of few bits, so positions, displacements and the touching point
    are exact in FP64. The sizes of the edges, of the motion and of the shift from the origin are
    spread; a third of the cases is flattened to a plane or a line (coplanar motion, slivers,
    parallel edges), some nodes coincide.
    """
    rng = np.random.default_rng(seed)
    beta = rng.integers(0, 9, (count, 2)) / 8.0
    if kind == POINT_TRIANGLE:
        beta = np.where(beta.sum(axis=1, keepdims=True) > 1.0, 1.0 - beta, beta)
    (a, b), one = beta.T, np.ones(count)
    signed = (one, a + b - one, -a, -b) if kind == POINT_TRIANGLE else (one - a, a, b - one, -b)
    weights = np.stack(signed, axis=1)
    x = rng.integers(-64, 65, (count, 4, 3)) * 8.0
    dx = rng.integers(-64, 65, (count, 4, 3)) * 16.0
    dx *= 2.0 ** rng.integers(-8, 1, (count, 1, 1))
    flat = rng.integers(0, 9, count)
    x[flat == 0, :, 2] = 0.0
    x[flat == 1, :, 1:] = 0.0
    dx[flat <= 1, :, 2] = 0.0
    dx[flat == 2] = dx[flat == 2, :1] * np.array([1.0, 0.0, 0.0, 0.0])[None, :, None]
    tiny = rng.random(count) < 0.1
    x[tiny, 2:] = x[tiny, 2:3] + rng.integers(-1, 2, (int(tiny.sum()), 2, 3)) * 2.0**-20
    time = rng.integers(1, 17, count) / 16.0
    # Shift the first primitive so that it touches the second at `time`.
    gap = np.einsum("ci,cia->ca", weights, x + time[:, None, None] * dx)
    x[:, : 1 if kind == POINT_TRIANGLE else 2] -= gap[:, None]
    assert not np.einsum("ci,cia->ca", weights, x + time[:, None, None] * dx).any()
    x += rng.choice([0.0, 2.0**20], (count, 1, 1))
    scale = 2.0 ** rng.integers(-30, 10, (count, 1, 1))
    return x * scale, dx * scale, time


@both_kinds
def test_no_collision_is_missed_and_the_promised_gap_is_left(kind: int) -> None:
    x, dx, time = colliding(kind, 0, 20000)
    toi, status, _ = collide(kind, x, dx)
    hit = status == CCD_HIT
    assert (toi < time).all() and (toi[status == CCD_START] == 0.0).all()
    assert not np.any(status == CCD_NO_HIT) and hit.sum() > 10000
    before = np.sqrt(query_pairs(kind, x[hit]).distance_sq)
    moved = x[hit] + toi[hit, None, None] * dx[hit]
    after = np.sqrt(query_pairs(kind, moved).distance_sq)
    assert np.all(after >= 0.1 * before - 1e-15 * np.abs(x[hit]).max(axis=(1, 2)))
    toi, status, iterations = collide(kind, x[:5000], dx[:5000], max_iterations=2)
    assert np.sum(status == CCD_CAPPED) > 50 and iterations.max() == 2
    assert np.all(toi < time[:5000]), "not late where it gives up"


@pytest.mark.thorough
@both_kinds
def test_close_to_tight_inclusion(kind: int) -> None:
    x, dx = np.random.default_rng(2).normal(size=(2, 5000, 4, 3))
    referee = ipctk.TightInclusionCCD(tolerance=1e-9, conservative_rescaling=1.0 - 1e-6)
    query = getattr(referee, f"{NAMES[kind]}_ccd")
    answers = [query(*start, *end) for start, end in zip(x, x + dx, strict=True)]
    collides, expected = np.array(answers).T
    collides = collides != 0
    assert collides.sum() > 180
    for slackness, floor in ((0.1, 0.7), (0.01, 0.95)):
        toi, status, iterations = collide(kind, x, dx, slackness=slackness)
        assert not np.any(status == CCD_CAPPED) and not np.any(status[collides] == CCD_NO_HIT)
        assert np.all(toi[collides] <= expected[collides] * (1.0 + 1e-9))
        # A collision after a near miss is reported at the near miss when its gap is in the slack.
        assert np.mean(toi[collides] > floor * expected[collides]) > 0.97
        assert np.mean(status[~collides] == CCD_NO_HIT) > 0.96 and iterations.mean() < 5
        assert iterations.max() < 300


@both_kinds
def test_the_thickness_is_kept_along_the_path(kind: int) -> None:
    thickness, samples = 0.05, 100
    x, dx = np.random.default_rng(6).normal(size=(2, 1000, 4, 3))
    apart = query_pairs(kind, x).distance_sq > thickness**2
    toi, status, _ = collide(kind, x, dx, thickness=thickness)
    np.testing.assert_array_equal(status == CCD_START, ~apart)
    fraction = np.linspace(0.0, 1.0, samples)[None, :, None, None]
    path = x[:, None] + fraction * toi[:, None, None, None] * dx[:, None]
    near = query_pairs(kind, path.reshape(-1, 4, 3)).distance_sq.reshape(-1, samples)
    assert np.all(np.sqrt(near[apart]) > thickness)
    # With the same motion, but no thickness, more of it is free.
    bare, *_ = collide(kind, x, dx)
    hit = apart & (status == CCD_HIT)
    assert np.mean(bare[hit] > toi[hit]) > 0.9


DOWN, ASIDE, MEETING, TOGETHER = np.zeros((4, 2, 4, 3))
DOWN[:, 0, 2], ASIDE[:, 0, 0], TOGETHER[:] = -1.0, 0.3, [3.0, -200.0, 7.0]
MEETING[:, 0, 2], MEETING[:, 1:, 2] = -1.0, 1.0


@pytest.mark.parametrize(
    ("gap", "dx", "options", "toi", "status"),
    [
        (0.5, MEETING, {}, 0.9 * 0.25, CCD_HIT),
        (0.5, MEETING, {"thickness": 0.1, "slackness": 0.5}, 0.5 * 0.2, CCD_HIT),
        (1e-9, ASIDE, {}, 1.0, CCD_NO_HIT),
        (1e-12, TOGETHER, {}, 1.0, CCD_NO_HIT),
        (0.0, DOWN, {}, 0.0, CCD_START),
        (0.05, DOWN, {"thickness": 0.1}, 0.0, CCD_START),
        (0.5, DOWN, {"t_max": 0.3}, 0.3, CCD_NO_HIT),
    ],
)
def test_known_times(gap: float, dx: Array, options: dict, toi: float, status: int) -> None:
    x = np.array([[[0.3, 0.3, gap], [0, 0, 0], [1, 0, 0], [0, 1, 0]]] * 2)
    found = collide(POINT_TRIANGLE, x, dx, **options)
    assert (found[0][0], found[1][0]) == (pytest.approx(toi, rel=1e-12), status)
    assert status != CCD_NO_HIT or found[2][0] <= 1, "a way that is free takes one step"


@both_kinds
def test_nan_never_counts_as_free(kind: int) -> None:
    x, dx = np.random.default_rng(7).normal(size=(2, 24, 4, 3))
    x.reshape(24, 12)[np.arange(12), np.arange(12)] = np.nan
    dx.reshape(24, 12)[np.arange(12, 24), np.arange(12)] = np.nan
    toi, status, _ = collide(kind, x, dx)
    assert np.all(status == CCD_START) and not toi.any()


def test_point_plane() -> None:
    rng, count = np.random.default_rng(5), 1000
    normal = unit(rng.normal(size=(count, 3)))
    x, dx = np.zeros((2, count, 4, 3))
    x[:, 1] = rng.normal(size=(count, 3))
    gap = 10.0 ** rng.uniform(-3, 0, count)
    x[:, 0] = x[:, 1] + gap[:, None] * normal + np.cross(normal, rng.normal(size=(count, 3)))
    x[:, 2] = normal
    dx[:, :2] = rng.normal(size=(count, 2, 3))
    closing = -np.sum((dx[:, 0] - dx[:, 1]) * normal, axis=1)
    toi, status, _ = collide(PLANE, x, dx, thickness=0.3 * gap)
    exact = np.where(closing > 0, 0.7 * gap / np.where(closing > 0, closing, 1), np.inf)
    hit = status == CCD_HIT
    np.testing.assert_array_equal(hit, 0.9 * exact < 1.0)
    np.testing.assert_allclose(toi[hit], 0.9 * exact[hit], rtol=1e-9)
    assert np.all(toi[~hit] == 1.0) and 200 < hit.sum() < 800
    x[:, 0] = x[:, 1] - gap[:, None] * normal
    assert np.all((collide(PLANE, x, dx)[1] == CCD_START) == (closing > 0))


# Degenerate queries -------------------------------------------------------------------------------

COUNT = 250
Queries = tuple[int, Array, Array]


def placed(kind: int, x: Array, dx: Array, rng: np.random.Generator) -> Queries:
    """Turn, scale and shift queries; what was degenerate is then so up to rounding."""
    turn = np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0]
    turn[rng.random(COUNT) < 0.25] = np.eye(3)
    scale = 10.0 ** rng.uniform(-6, 3, (COUNT, 1, 1)) * np.ones_like(x)
    scale[rng.random(COUNT) < 0.25] = 1.0
    x, dx = (scale * np.einsum("cij,cnj->cni", turn, part) for part in (x, dx))
    return kind, x, dx


def triangle(rng: np.random.Generator) -> Array:
    """Triangles in z = 0 of very different shape, [COUNT, 3, 3]."""
    corners = rng.uniform(-1, 1, (COUNT, 3, 3))
    corners[..., 2] = 0
    corners[rng.random(COUNT) < 0.3, :, 1] *= 1e-6
    return corners


def inside(rng: np.random.Generator, corners: Array) -> Array:
    """Points of triangles: in the face, on an edge, at a corner, [COUNT, 3]."""
    weights = rng.dirichlet(np.ones(3), COUNT)
    weights[rng.random(COUNT) < 0.3, 0] = 0.0
    weights[rng.random(COUNT) < 0.3, 1] = 0.0
    weights[weights.sum(axis=1) == 0] = [0, 0, 1]
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("ck,cki->ci", weights, corners)


def below(point: Array, corners: Array) -> tuple[Array, Array]:
    x = np.concatenate([point[:, None], corners], axis=1)
    return x, np.zeros_like(x)


def half(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    return rng.random(shape) < 0.5


def spike_on_face(rng: np.random.Generator) -> Queries:
    """A tip comes down on a face, an edge or a corner, from a gap between 1e-12 and 1."""
    corners = triangle(rng)
    gap = 10.0 ** rng.uniform(-12, 0, (COUNT, 1))
    x, dx = below(inside(rng, corners) + gap * [0, 0, 1], corners)
    dx[:, 0, 2] = -(10.0 ** rng.uniform(-1, 3, COUNT)) * gap[:, 0]
    dx[:, 1:, :2] = rng.normal(size=(COUNT, 3, 2)) * half(rng, (COUNT, 1, 1)) * gap[:, None]
    return placed(POINT_TRIANGLE, x, dx, rng)


def grazing(rng: np.random.Generator) -> Queries:
    """A point flies through an edge or a corner, or passes it by some rounding errors."""
    corners = triangle(rng)
    beside = 10.0 ** rng.uniform(-18, -9, (COUNT, 1)) * rng.normal(size=(COUNT, 3))
    beside[rng.random(COUNT) < 0.3] = 0
    target = corners[:, 0] + rng.integers(0, 3, (COUNT, 1)) / 2 * (corners[:, 1] - corners[:, 0])
    way = rng.normal(size=(COUNT, 3))
    x, dx = below(target + beside - 0.5 * way, corners)
    dx[:, 0] = way
    return placed(POINT_TRIANGLE, x, dx, rng)


def crack(rng: np.random.Generator) -> Queries:
    """A point slides into a gap of 1e-9 over a face while the face closes it."""
    corners, gap = triangle(rng), 1e-9
    x, dx = below(inside(rng, corners) + [0, 0, gap], corners)
    dx[:, 0, :2] = rng.normal(size=(COUNT, 2))
    dx[:, 1:, 2] = gap * rng.uniform(0, 4, (COUNT, 1))
    dx[:, 1:, 2] += gap * rng.normal(size=(COUNT, 3)) * half(rng, (COUNT, 1))
    return placed(POINT_TRIANGLE, x, dx, rng)


def coplanar_point(rng: np.random.Generator) -> Queries:
    """All nodes stay in one plane: the point enters the triangle through its outline."""
    corners = triangle(rng)
    x, _ = below(rng.uniform(-3, 3, (COUNT, 3)), corners)
    dx = rng.normal(size=x.shape)
    dx[:, 0] = 2 * (inside(rng, corners) - x[:, 0])
    x[..., 2] = dx[..., 2] = 0
    return POINT_TRIANGLE, x, dx


def far_away(rng: np.random.Generator) -> Queries:
    """Coordinates of a million sizes."""
    kind, x, dx = spike_on_face(rng)
    size = np.abs(x).max(axis=(1, 2), keepdims=True)
    return kind, x + 1e6 * size * rng.normal(size=(COUNT, 1, 3)), dx


def bullet(rng: np.random.Generator) -> Queries:
    """A motion of a million sizes, all nodes at once."""
    corners = triangle(rng)
    x, _ = below(inside(rng, corners) + [0, 0, 0.1], corners)
    dx = 1e6 * rng.normal(size=(COUNT, 1, 3)) + rng.normal(size=x.shape)
    dx[:, 0, 2] -= rng.uniform(0, 1e6, COUNT)
    return placed(POINT_TRIANGLE, x, dx, rng)


def crossed(s: Array, t: Array, u: Array, v: Array, gap: Array) -> tuple[Array, Array]:
    """Edges along u and v that cross at their parts s and t, a gap apart along z; no motion yet."""
    x = np.stack([-s * u, (1 - s) * u, -t * v, (1 - t) * v], axis=1)
    x[:, :2, 2] += gap
    return x, np.zeros_like(x)


def wedge_on_wedge(rng: np.random.Generator) -> Queries:
    """Two edges cross, also at their very ends, from gaps between 1e-12 and 1."""
    s, t = rng.integers(0, 5, (2, COUNT, 1)) / 4
    u, v = rng.normal(size=(2, COUNT, 3)) * [1, 1, 0]
    gap = 10.0 ** rng.uniform(-12, 0, (COUNT, 1))
    x, dx = crossed(s, t, u, v, gap)
    dx[:, :2, 2] = -(10.0 ** rng.uniform(-1, 3, (COUNT, 1))) * gap
    dx[:, 2:, :2] = rng.normal(size=(COUNT, 2, 2)) * gap[..., None] * half(rng, (COUNT, 1, 1))
    return placed(EDGE_EDGE, x, dx, rng)


def nearly_parallel(rng: np.random.Generator) -> Queries:
    """Edges at angles between 1e-12 and 0.1 rad that roll over one another."""
    angle = 10.0 ** rng.uniform(-12, -1, (COUNT, 1))
    s, t = rng.uniform(0, 1, (2, COUNT, 1))
    gap = 10.0 ** rng.uniform(-9, -1, (COUNT, 1))
    u = np.tile([1.0, 0, 0], (COUNT, 1))
    x, dx = crossed(s, t, u, u + angle * [0, 1, 0], gap)
    dx[:, :2, 2] = -3 * gap
    dx[:, 1] += gap * rng.normal(size=(COUNT, 3)) * half(rng, (COUNT, 1))
    return placed(EDGE_EDGE, x, dx, rng)


def coplanar_edges(rng: np.random.Generator) -> Queries:
    """Edges that stay in one plane and meet with an end."""
    x, dx = rng.normal(size=(2, COUNT, 4, 3))
    x[:, :2] += 4 * unit(rng.normal(size=(COUNT, 1, 3)))
    dx[:, :2] -= 1.5 * x[:, :2].mean(axis=1, keepdims=True)
    x[..., 2] = dx[..., 2] = 0
    return EDGE_EDGE, x, dx


def short_edges(rng: np.random.Generator) -> Queries:
    """An edge of a millionth of the length of the other."""
    kind, x, dx = wedge_on_wedge(rng)
    middle = x[:, 2:].mean(axis=1, keepdims=True)
    x[:, 2:] = middle + 1e-6 * (x[:, 2:] - middle)
    return kind, x, dx


POINTS = (spike_on_face, grazing, crack, coplanar_point, far_away, bullet)
EDGES = (wedge_on_wedge, nearly_parallel, coplanar_edges, short_edges)
FEW = {coplanar_point: 8, coplanar_edges: 8, bullet: 80, spike_on_face: 80}
"""Where exact arithmetic is slow: no cubic tells where to look."""
DEAR = tuple(family.__name__ for family in POINTS + EDGES if family is not spike_on_face)


@pytest.mark.thorough(cases=DEAR)
@pytest.mark.parametrize("family", POINTS + EDGES)
def test_never_late_in_exact_arithmetic(family: Callable[[np.random.Generator], Queries]) -> None:
    kind, x, dx = family(np.random.default_rng(11))
    x, dx = x[: FEW.get(family)], dx[: FEW.get(family)]
    toi, status, _ = collide(kind, x, dx)
    truth = [earliest_contact(kind, *query) for query in zip(x, dx, strict=True)]
    hits = np.array([found is not None for found in truth])
    before, latest = np.array([found or (np.inf, np.inf) for found in truth]).T
    assert hits.sum() >= 0.1 * len(x), "the family is no test"
    missed = hits & ((toi > latest) | (status == CCD_NO_HIT))
    assert not missed.any(), f"queries {np.flatnonzero(missed)[:3]} of {family.__name__}"
    # Isolating intervals are wide: the start of each is a collision-free time all the same.
    sharp = hits & (before == latest)
    assert np.all(toi[sharp] <= before[sharp])


@pytest.mark.parametrize("family", POINTS + EDGES)
def test_most_of_the_way_is_taken(family: Callable[[np.random.Generator], Queries]) -> None:
    """A query that always answers zero is never late, and no use: gaps over rounding are used."""
    kind, x, dx = family(np.random.default_rng(13))
    toi, status, _ = collide(kind, x, dx)
    extent = np.abs(x).max(axis=(1, 2)) + np.abs(dx).max(axis=(1, 2))
    clear = np.sqrt(query_pairs(kind, x).distance_sq) > 1e-13 * extent
    assert not np.any(status[clear] == CCD_START) and np.all(toi[clear] > 0)
    assert np.mean(status == CCD_CAPPED) < 0.02


def test_the_exact_referee_knows_a_hit_from_a_miss() -> None:
    faces = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    for x, y, hits in ((0.25, 0.25, True), (0.76, 0.25, False), (0.5, 0.5, True)):
        nodes, way = np.array([[x, y, 1], *faces], dtype=float), DOWN[0] * 4
        found = earliest_contact(POINT_TRIANGLE, nodes, way)
        assert (found is not None and found[0] <= 0.25 <= found[1]) == hits
    for aside, hits in ((0.0, True), (1 + 1e-12, False)):
        ends = [[-1, 0, 1], [1, 0, 1], [aside, -1, 0], [aside, 1, 0]]
        way = np.array([[0, 0, -2.0]] * 2 + [[0, 0, 0]] * 2)
        found = earliest_contact(EDGE_EDGE, np.array(ends, dtype=float), way)
        assert (found is not None and found[0] <= 0.5 <= found[1]) == hits
