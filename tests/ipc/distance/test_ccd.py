# SPDX-License-Identifier: Apache-2.0
"""Continuous collision detection: never late, rarely early, against exact and ipctk queries."""

from __future__ import annotations

from functools import lru_cache

import ipctk
import numpy as np
import pytest

from taccel_lab.ipc.distance.ccd import CCD_CAPPED, CCD_HIT, CCD_NO_HIT, CCD_START
from tests.ipc import batch
from tests.ipc.batch import Array

KINDS = {"point_triangle": batch.POINT_TRIANGLE, "edge_edge": batch.EDGE_EDGE}
PLANE = 2


def weights_of(kind: int, beta: Array) -> Array:
    """Signed stencil weights of closest-point parameters beta, shape [count, 2]."""
    a, b = beta[:, 0], beta[:, 1]
    one = np.ones_like(a)
    if kind == batch.POINT_TRIANGLE:
        return np.stack([one, a + b - one, -a, -b], axis=1)
    return np.stack([one - a, a, b - one, -b], axis=1)


def colliding(kind: int, seed: int, count: int) -> tuple[Array, Array, Array]:
    """Stencils, displacements and a time at which they touch in exact arithmetic.

    Everything is a dyadic rational of few bits, so positions, displacements and the touching point
    are exact in FP64. The sizes of the edges, of the motion and of the shift from the origin are
    spread; a third of the cases is flattened to a plane or a line (coplanar motion, slivers,
    parallel edges), some nodes coincide.
    """
    rng = np.random.default_rng(seed)
    beta = rng.integers(0, 9, (count, 2)) / 8.0
    if kind == batch.POINT_TRIANGLE:
        beta = np.where(beta.sum(axis=1, keepdims=True) > 1.0, 1.0 - beta, beta)
    weights = weights_of(kind, beta)
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
    at_time = x + time[:, None, None] * dx
    gap = np.einsum("ci,cia->ca", weights, at_time)
    first = 1 if kind == batch.POINT_TRIANGLE else 2
    x[:, :first] -= gap[:, None]
    touching = np.einsum("ci,cia->ca", weights, x + time[:, None, None] * dx)
    assert np.all(touching == 0.0)
    x += rng.choice([0.0, 2.0**20], (count, 1, 1))
    scale = 2.0 ** rng.integers(-30, 10, (count, 1, 1))
    return x * scale, dx * scale, time


@lru_cache
def moving(name: str) -> tuple[Array, Array, Array]:
    """Random stencils and ways; earliest times by ipctk's Tight-Inclusion, infinite without one."""
    x, dx = np.random.default_rng(2).normal(size=(2, 5000, 4, 3))
    referee = ipctk.TightInclusionCCD(tolerance=1e-9, conservative_rescaling=1.0 - 1e-6)
    query = getattr(referee, f"{name}_ccd")
    times = np.full(len(x), np.inf)
    for i, (start, motion) in enumerate(zip(x, dx, strict=True)):
        hit, toi = query(*start, *(start + motion))
        if hit:
            times[i] = toi
    return x, dx, times


@pytest.mark.parametrize("name", KINDS)
def test_no_collision_is_missed(name: str) -> None:
    kind = KINDS[name]
    x, dx, time = colliding(kind, 0, 20000)
    toi, status, _ = batch.collide(kind, x, dx)
    late = toi >= time
    assert not np.any(late), f"{late.sum()} missed, first {np.flatnonzero(late)[:3]}"
    assert not np.any(status == CCD_NO_HIT)
    assert np.sum(status == CCD_HIT) > 10000
    assert np.all(toi[status == CCD_START] == 0.0)


@pytest.mark.parametrize("name", KINDS)
def test_the_gap_that_is_promised_is_left(name: str) -> None:
    kind = KINDS[name]
    x, dx, _ = colliding(kind, 1, 20000)
    toi, status, _ = batch.collide(kind, x, dx)
    hit = status == CCD_HIT
    before = np.sqrt(batch.query_pairs(kind, x[hit]).distance_sq)
    moved = x[hit] + toi[hit, None, None] * dx[hit]
    after = np.sqrt(batch.query_pairs(kind, moved).distance_sq)
    extent = np.abs(x[hit]).max(axis=(1, 2))
    assert np.all(after >= 0.1 * before - 1e-15 * extent)


@pytest.mark.thorough
@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize(("slackness", "floor"), [(0.1, 0.7), (0.01, 0.95)])
def test_close_to_tight_inclusion(name: str, slackness: float, floor: float) -> None:
    kind = KINDS[name]
    x, dx, expected = moving(name)
    toi, status, iterations = batch.collide(kind, x, dx, slackness=slackness)
    collides = np.isfinite(expected)
    assert collides.sum() > 180
    assert not np.any(status == CCD_CAPPED)
    assert not np.any(status[collides] == CCD_NO_HIT)
    assert np.all(toi[collides] <= expected[collides] * (1.0 + 1e-9))
    # A collision after a near miss is reported at the near miss when its gap is in the slackness.
    assert np.mean(toi[collides] > floor * expected[collides]) > 0.97
    assert np.mean(status[~collides] == CCD_NO_HIT) > 0.96
    assert iterations.mean() < 5
    assert iterations.max() < 300


@pytest.mark.parametrize("name", KINDS)
def test_the_thickness_is_kept_along_the_path(name: str) -> None:
    kind, thickness, samples = KINDS[name], 0.05, 100
    x, dx = np.random.default_rng(6).normal(size=(2, 1000, 4, 3))
    apart = batch.query_pairs(kind, x).distance_sq > thickness**2
    toi, status, _ = batch.collide(kind, x, dx, thickness=thickness)
    np.testing.assert_array_equal(status == CCD_START, ~apart)
    fraction = np.linspace(0.0, 1.0, samples)[None, :, None, None]
    path = x[:, None] + fraction * toi[:, None, None, None] * dx[:, None]
    near = batch.query_pairs(kind, path.reshape(-1, 4, 3)).distance_sq.reshape(-1, samples)
    assert np.all(np.sqrt(near[apart]) > thickness)
    # With the same motion, but no thickness, more of it is free.
    bare, *_ = batch.collide(kind, x, dx)
    assert np.mean(bare[apart & (status == CCD_HIT)] > toi[apart & (status == CCD_HIT)]) > 0.9


def triangle_below(gap: float) -> Array:
    return np.array([[[0.3, 0.3, gap], [0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=float)


DOWN, ASIDE, MEETING = np.zeros((3, 1, 4, 3))
DOWN[0, 0, 2], ASIDE[0, 0, 0] = -1.0, 0.3
MEETING[0, 0, 2], MEETING[0, 1:, 2] = -1.0, 1.0
TOGETHER = np.broadcast_to(np.array([3.0, -200.0, 7.0]), (1, 4, 3))


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
    found = batch.collide(batch.POINT_TRIANGLE, triangle_below(gap), dx, **options)
    assert (found[0][0], found[1][0]) == (pytest.approx(toi, rel=1e-12), status)
    assert status != CCD_NO_HIT or found[2][0] <= 1, "a way that is free takes one step"


@pytest.mark.parametrize("name", KINDS)
def test_nan_never_counts_as_free(name: str) -> None:
    x, dx = np.random.default_rng(7).normal(size=(2, 24, 4, 3))
    x.reshape(24, 12)[np.arange(12), np.arange(12)] = np.nan
    dx.reshape(24, 12)[np.arange(12, 24), np.arange(12)] = np.nan
    toi, status, _ = batch.collide(KINDS[name], x, dx)
    assert np.all(status == CCD_START)
    assert np.all(toi == 0.0)


@pytest.mark.parametrize("name", KINDS)
def test_iteration_cap_is_conservative(name: str) -> None:
    kind = KINDS[name]
    x, dx, time = colliding(kind, 4, 5000)
    toi, status, iterations = batch.collide(kind, x, dx, max_iterations=2)
    assert np.sum(status == CCD_CAPPED) > 50
    assert iterations.max() == 2
    assert np.all(toi < time)


def test_point_plane() -> None:
    rng = np.random.default_rng(5)
    count = 1000
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    x, dx = np.zeros((2, count, 4, 3))
    x[:, 1] = rng.normal(size=(count, 3))
    gap = 10.0 ** rng.uniform(-3, 0, count)
    x[:, 0] = x[:, 1] + gap[:, None] * normal + np.cross(normal, rng.normal(size=(count, 3)))
    x[:, 2] = normal
    dx[:, :2] = rng.normal(size=(count, 2, 3))
    closing = -np.sum((dx[:, 0] - dx[:, 1]) * normal, axis=1)
    thickness = 0.3 * gap
    toi, status, _ = batch.collide(PLANE, x, dx, thickness=thickness)
    exact = np.where(closing > 0, (gap - thickness) / np.where(closing > 0, closing, 1), np.inf)
    hit = status == CCD_HIT
    np.testing.assert_array_equal(hit, 0.9 * exact < 1.0)
    np.testing.assert_allclose(toi[hit], 0.9 * exact[hit], rtol=1e-9)
    assert np.all(toi[~hit] == 1.0)
    assert 200 < hit.sum() < 800
    x[:, 0] = x[:, 1] - gap[:, None] * normal
    toi, status, _ = batch.collide(PLANE, x, dx)
    assert np.all((status == CCD_START) == (closing > 0))
