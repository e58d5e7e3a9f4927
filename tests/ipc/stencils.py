# SPDX-License-Identifier: Apache-2.0
"""Stencils of four nodes for tests: random, nearly parallel and degenerate; exact distances."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
from hypothesis import strategies as st

from tests.ipc.batch import Array


def random_stencils(seed: int, count: int) -> Array:
    """Standard normal nodes, shape [count, 4, 3]; every region of both queries occurs."""
    return np.random.default_rng(seed).normal(size=(count, 4, 3))


def nearly_parallel_edges(
    seed: int, count: int, angle_exponents: tuple[float, float] = (-9.0, -1.0)
) -> Array:
    """Edges of length about 1 with log-uniform angles [rad], and gaps log-uniform in 1e-4 .. 1."""
    rng = np.random.default_rng(seed)
    direction = _unit(rng.normal(size=(count, 3)))
    across = _unit(np.cross(direction, rng.normal(size=(count, 3))))
    normal = np.cross(direction, across)
    angle = 10.0 ** rng.uniform(*angle_exponents, size=(count, 1))
    gap = 10.0 ** rng.uniform(-4, 0, size=(count, 1))
    start = rng.normal(size=(count, 3))
    shift = rng.uniform(-0.8, 0.8, size=(count, 1))
    other = direction + angle * across
    eb0 = start + shift * direction - angle * rng.uniform(0, 1, (count, 1)) * across + gap * normal
    return np.stack([start, start + direction, eb0, eb0 + other], axis=1)


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@st.composite
def degenerate_stencils(draw: st.DrawFn) -> Array:
    """Nodes on a coarse grid, hence often coincident, collinear, coplanar or parallel, then scaled,
    shifted by a power of two and some of them moved by a few ulp."""
    grid = st.integers(-2, 2)
    nodes = np.array(draw(st.lists(grid, min_size=12, max_size=12)), dtype=np.float64)
    stencil = nodes.reshape(4, 3) * 10.0 ** draw(st.integers(-7, 2))
    stencil = stencil + draw(st.sampled_from([0.0, 0.0, 0.5, 1024.0]))
    if draw(st.booleans()):
        nudges = draw(st.lists(st.integers(-3, 3), min_size=12, max_size=12))
        stencil = stencil + np.array(nudges).reshape(4, 3) * np.spacing(np.abs(stencil))
    return stencil


# --- exact distances in rational arithmetic -------------------------------------------------------

_Vector = list[Fraction]


def _rational(nodes: Array) -> list[_Vector]:
    return [[Fraction(float(c)) for c in node] for node in nodes]


def _sub(a: _Vector, b: _Vector) -> _Vector:
    return [x - y for x, y in zip(a, b, strict=True)]


def _dot(a: _Vector, b: _Vector) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def _point_edge(p: _Vector, a: _Vector, b: _Vector) -> Fraction:
    e = _sub(b, a)
    length = _dot(e, e)
    t = Fraction(0) if length == 0 else min(max(_dot(_sub(p, a), e) / length, 0), 1)
    r = [x - t * y for x, y in zip(_sub(p, a), e, strict=True)]
    return _dot(r, r)


def _stationary(u: _Vector, v: _Vector, r: _Vector) -> tuple[Fraction, Fraction, Fraction] | None:
    """a, b that minimise |r - a u - b v|^2, and the minimum; None when u and v are parallel."""
    uu, uv, vv = _dot(u, u), _dot(u, v), _dot(v, v)
    det = uu * vv - uv * uv
    if det == 0:
        return None
    ru, rv = _dot(r, u), _dot(r, v)
    a = (ru * vv - rv * uv) / det
    b = (rv * uu - ru * uv) / det
    rest = [x - a * y - b * z for x, y, z in zip(r, u, v, strict=True)]
    return a, b, _dot(rest, rest)


def exact_point_triangle_sq(nodes: Array) -> float:
    """Squared point-triangle distance without rounding but the last."""
    p, *t = _rational(nodes)
    best = min(_point_edge(p, a, b) for a, b in pairwise([*t, t[0]]))
    inner = _stationary(_sub(t[1], t[0]), _sub(t[2], t[0]), _sub(p, t[0]))
    if inner and inner[0] >= 0 and inner[1] >= 0 and inner[0] + inner[1] <= 1:
        best = min(best, inner[2])
    return float(best)


def exact_edge_edge_sq(nodes: Array) -> float:
    """Squared segment-segment distance without rounding but the last."""
    a0, a1, b0, b1 = _rational(nodes)
    best = min(
        _point_edge(a0, b0, b1),
        _point_edge(a1, b0, b1),
        _point_edge(b0, a0, a1),
        _point_edge(b1, a0, a1),
    )
    inner = _stationary(_sub(a1, a0), _sub(b0, b1), _sub(b0, a0))
    if inner and 0 <= inner[0] <= 1 and 0 <= inner[1] <= 1:
        best = min(best, inner[2])
    return float(best)
