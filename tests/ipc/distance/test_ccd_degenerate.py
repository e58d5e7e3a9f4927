# SPDX-License-Identifier: Apache-2.0
"""Degenerate queries after those of Wang et al. (2021), A Large-scale Benchmark and an Inclusion-
based Algorithm for Continuous Collision Detection, and Erleben (2018): never late, against exact
rational arithmetic."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from taccel_lab.ipc.distance.ccd import CCD_CAPPED, CCD_NO_HIT, CCD_START
from tests.ipc import batch
from tests.ipc.batch import EDGE_EDGE, POINT_TRIANGLE, Array
from tests.ipc.exact_ccd import as_stencils, earliest_contact

COUNT = 250
Queries = tuple[int, Array, Array]


def unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def frames(rng: np.random.Generator) -> Array:
    """Random rotations, one in four the identity, shape [COUNT, 3, 3]."""
    q = np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0]
    q[rng.random(COUNT) < 0.25] = np.eye(3)
    return q


def placed(kind: int, x: Array, dx: Array, rng: np.random.Generator) -> Queries:
    """Turn, scale and shift queries; what was degenerate is then so up to rounding."""
    turn = frames(rng)
    scale = 10.0 ** rng.uniform(-6, 3, (COUNT, 1, 1)) * np.ones_like(x)
    scale[rng.random(COUNT) < 0.25] = 1.0
    return (
        kind,
        scale * np.einsum("cij,cnj->cni", turn, x),
        scale * np.einsum("cij,cnj->cni", turn, dx),
    )


def triangle(rng: np.random.Generator) -> Array:
    """Triangles in z = 0 of very different shape, [COUNT, 3, 3]."""
    corners = rng.uniform(-1, 1, (COUNT, 3, 3))
    corners[..., 2] = 0
    thin = rng.random(COUNT) < 0.3
    corners[thin, :, 1] *= 1e-6
    return corners


def inside(rng: np.random.Generator, corners: Array) -> Array:
    """Points of triangles: in the face, on an edge, at a corner, [COUNT, 3]."""
    weights = rng.dirichlet(np.ones(3), COUNT)
    weights[rng.random(COUNT) < 0.3, 0] = 0.0
    weights[rng.random(COUNT) < 0.3, 1] = 0.0
    weights[weights.sum(axis=1) == 0] = [0, 0, 1]
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("ck,cki->ci", weights, corners)


def spike_on_face(rng: np.random.Generator) -> Queries:
    """A tip comes down on a face, an edge or a corner, from a gap between 1e-12 and 1."""
    corners = triangle(rng)
    gap = 10.0 ** rng.uniform(-12, 0, (COUNT, 1))
    tip = inside(rng, corners) + gap * [0, 0, 1]
    x = np.concatenate([tip[:, None], corners], axis=1)
    dx = np.zeros_like(x)
    dx[:, 0, 2] = -(10.0 ** rng.uniform(-1, 3, COUNT)) * gap[:, 0]
    dx[:, 1:, :2] = (
        rng.normal(size=(COUNT, 3, 2)) * (rng.random((COUNT, 1, 1)) < 0.5) * gap[:, None]
    )
    return placed(POINT_TRIANGLE, x, dx, rng)


def grazing(rng: np.random.Generator) -> Queries:
    """A point flies through an edge or a corner, or passes it by some rounding errors."""
    corners = triangle(rng)
    beside = 10.0 ** rng.uniform(-18, -9, (COUNT, 1)) * rng.normal(size=(COUNT, 3))
    beside[rng.random(COUNT) < 0.3] = 0
    target = corners[:, 0] + rng.integers(0, 3, (COUNT, 1)) / 2 * (corners[:, 1] - corners[:, 0])
    way = rng.normal(size=(COUNT, 3))
    x = np.concatenate([(target + beside - 0.5 * way)[:, None], corners], axis=1)
    dx = np.zeros_like(x)
    dx[:, 0] = way
    return placed(POINT_TRIANGLE, x, dx, rng)


def crack(rng: np.random.Generator) -> Queries:
    """A point slides into a gap of 1e-9 over a face while the face closes it."""
    corners = triangle(rng)
    gap = 1e-9
    tip = inside(rng, corners) + [0, 0, gap]
    x = np.concatenate([tip[:, None], corners], axis=1)
    dx = np.zeros_like(x)
    dx[:, 0, :2] = rng.normal(size=(COUNT, 2))
    dx[:, 1:, 2] = gap * rng.uniform(0, 4, (COUNT, 1))
    dx[:, 1:, 2] += gap * rng.normal(size=(COUNT, 3)) * (rng.random((COUNT, 1)) < 0.5)
    return placed(POINT_TRIANGLE, x, dx, rng)


def coplanar_point(rng: np.random.Generator) -> Queries:
    """All nodes stay in one plane: the point enters the triangle through its outline."""
    corners = triangle(rng)
    x = np.concatenate([rng.uniform(-3, 3, (COUNT, 1, 3)), corners], axis=1)
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
    x = np.concatenate([(inside(rng, corners) + [0, 0, 0.1])[:, None], corners], axis=1)
    dx = 1e6 * rng.normal(size=(COUNT, 1, 3)) + rng.normal(size=x.shape)
    dx[:, 0, 2] -= rng.uniform(0, 1e6, COUNT)
    return placed(POINT_TRIANGLE, x, dx, rng)


def wedge_on_wedge(rng: np.random.Generator) -> Queries:
    """Two edges cross, also at their very ends, from gaps between 1e-12 and 1."""
    s, t = rng.integers(0, 5, (2, COUNT, 1)) / 4
    u, v = rng.normal(size=(2, COUNT, 3))
    u[:, 2] = v[:, 2] = 0
    gap = 10.0 ** rng.uniform(-12, 0, (COUNT, 1))
    x = as_stencils(-s * u, (1 - s) * u, -t * v, (1 - t) * v)
    x[:, :2, 2] += gap
    dx = np.zeros_like(x)
    dx[:, :2, 2] = -(10.0 ** rng.uniform(-1, 3, (COUNT, 1))) * gap
    dx[:, 2:, :2] = (
        rng.normal(size=(COUNT, 2, 2)) * gap[..., None] * (rng.random((COUNT, 1, 1)) < 0.5)
    )
    return placed(EDGE_EDGE, x, dx, rng)


def nearly_parallel(rng: np.random.Generator) -> Queries:
    """Edges at angles between 1e-12 and 0.1 rad that roll over one another."""
    angle = 10.0 ** rng.uniform(-12, -1, (COUNT, 1))
    along, across, up = np.eye(3)
    u = np.tile(along, (COUNT, 1))
    v = u + angle * across
    s, t = rng.uniform(0, 1, (2, COUNT, 1))
    gap = 10.0 ** rng.uniform(-9, -1, (COUNT, 1))
    x = as_stencils(-s * u + gap * up, (1 - s) * u + gap * up, -t * v, (1 - t) * v)
    dx = np.zeros_like(x)
    dx[:, :2] = -3 * gap[..., None] * up
    dx[:, 1] += gap * rng.normal(size=(COUNT, 3)) * (rng.random((COUNT, 1)) < 0.5)
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


FAMILIES: tuple[Callable[[np.random.Generator], Queries], ...] = (
    spike_on_face,
    grazing,
    crack,
    coplanar_point,
    far_away,
    bullet,
    wedge_on_wedge,
    nearly_parallel,
    coplanar_edges,
    short_edges,
)


@pytest.mark.thorough(
    cases=(
        "bullet",
        "coplanar_edges",
        "coplanar_point",
        "crack",
        "far_away",
        "grazing",
        "nearly_parallel",
        "short_edges",
        "wedge_on_wedge",
    )
)
@pytest.mark.parametrize("family", FAMILIES)
def test_never_late_in_exact_arithmetic(family: Callable[[np.random.Generator], Queries]) -> None:
    kind, x, dx = family(np.random.default_rng(11))
    if family in (coplanar_point, coplanar_edges):
        x, dx = x[:8], dx[:8]  # fifty times as slow: no cubic tells where to look
    elif family in (bullet, spike_on_face):
        x, dx = x[:80], dx[:80]
    toi, status, _ = batch.collide(kind, x, dx)
    truth = [earliest_contact(kind, *query) for query in zip(x, dx, strict=True)]
    hits = np.array([found is not None for found in truth])
    latest = np.array([found[1] if found else np.inf for found in truth])
    assert hits.sum() >= 0.1 * len(x), "the family is no test"
    missed = hits & ((toi > latest) | (status == CCD_NO_HIT))
    assert not missed.any(), f"queries {np.flatnonzero(missed)[:3]} of {family.__name__}"
    # Isolating intervals are wide: the start of each is a collision-free time all the same.
    before = np.array([found[0] if found else np.inf for found in truth])
    assert np.all(toi[hits & (before == latest)] <= before[hits & (before == latest)])


@pytest.mark.parametrize("family", FAMILIES)
def test_most_of_the_way_is_taken(family: Callable[[np.random.Generator], Queries]) -> None:
    """A query that always answers zero is never late, and no use: gaps over rounding are used."""
    kind, x, dx = family(np.random.default_rng(13))
    toi, status, _ = batch.collide(kind, x, dx)
    extent = np.abs(x).max(axis=(1, 2)) + np.abs(dx).max(axis=(1, 2))
    gap = np.sqrt(batch.query_pairs(kind, x).distance_sq)
    clear = gap > 1e-13 * extent
    assert not np.any(status[clear] == CCD_START)
    assert np.all(toi[clear] > 0)
    assert np.mean(status == CCD_CAPPED) < 0.02


def test_the_exact_referee_knows_a_hit_from_a_miss() -> None:
    x = np.array([[0.25, 0.25, 1], [0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=float)
    dx = np.zeros((4, 3))
    dx[0, 2] = -4
    found = earliest_contact(POINT_TRIANGLE, x, dx)
    assert found is not None and found[0] <= 0.25 <= found[1]
    x[0, 0] = 0.76
    assert earliest_contact(POINT_TRIANGLE, x, dx) is None
    x[0] = [0.5, 0.5, 1]
    assert earliest_contact(POINT_TRIANGLE, x, dx) is not None, "on the edge"
    crossing = np.array([[-1, 0, 1], [1, 0, 1], [0, -1, 0], [0, 1, 0]], dtype=float)
    dx = np.zeros((4, 3))
    dx[:2, 2] = -2
    found = earliest_contact(EDGE_EDGE, crossing, dx)
    assert found is not None and found[0] <= 0.5 <= found[1]
    crossing[2:, 0] = 1 + 1e-12
    assert earliest_contact(EDGE_EDGE, crossing, dx) is None
