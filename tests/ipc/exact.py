# SPDX-License-Identifier: Apache-2.0
"""Distances and earliest collisions in exact rational arithmetic.

Four nodes that move along straight lines are coplanar at the roots of a cubic; whether the point is
then in the triangle, or the edges cross, is the sign of quartics at that root. Roots are isolated
with Sturm sequences over fractions, so the answer has no rounding at all.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise, zip_longest

import numpy as np

from tests.ipc.batch import POINT_TRIANGLE, Array

fractions = np.frompyfunc(Fraction, 1, 1)


def _point_edge(p: Array, a: Array, b: Array) -> Fraction:
    edge, r = b - a, p - a
    length = edge @ edge
    r = r - (min(max(r @ edge / length, 0), 1) if length else 0) * edge
    return r @ r


def _stationary(u: Array, v: Array, r: Array) -> tuple[Fraction, Fraction, Fraction] | None:
    """a, b that minimise |r - a u - b v|^2, and the minimum; None when u and v are parallel."""
    uu, uv, vv, ru, rv = u @ u, u @ v, v @ v, r @ u, r @ v
    det = uu * vv - uv * uv
    if det == 0:
        return None
    a, b = (ru * vv - rv * uv) / det, (rv * uu - ru * uv) / det
    rest = r - a * u - b * v
    return a, b, rest @ rest


def exact_point_triangle_sq(nodes: Array) -> float:
    p, *t = fractions(nodes)
    best = min(_point_edge(p, a, b) for a, b in pairwise([*t, t[0]]))
    inner = _stationary(t[1] - t[0], t[2] - t[0], p - t[0])
    if inner and inner[0] >= 0 and inner[1] >= 0 and inner[0] + inner[1] <= 1:
        best = min(best, inner[2])
    return float(best)


def exact_edge_edge_sq(nodes: Array) -> float:
    a0, a1, b0, b1 = fractions(nodes)
    ends = ((a0, b0, b1), (a1, b0, b1), (b0, a0, a1), (b1, a0, a1))
    best = min(_point_edge(*end) for end in ends)
    inner = _stationary(a1 - a0, b0 - b1, b0 - a0)
    if inner and 0 <= inner[0] <= 1 and 0 <= inner[1] <= 1:
        best = min(best, inner[2])
    return float(best)


# Motion -------------------------------------------------------------------------------------------

Polynomial = list[Fraction]
"""Coefficients, constant first, without trailing zeros."""
Vector = list[Polynomial]

_REFINEMENTS = 80


def _trim(p: Polynomial) -> Polynomial:
    while p and p[-1] == 0:
        p = p[:-1]
    return p


def _add(p: Polynomial, q: Polynomial, factor: int = 1) -> Polynomial:
    return _trim([x + factor * y for x, y in zip_longest(p, q, fillvalue=Fraction(0))])


def _times(p: Polynomial, q: Polynomial) -> Polynomial:
    if not p or not q:
        return []
    out = [Fraction(0)] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(q):
            out[i + j] += a * b
    return _trim(out)


def _at(p: Polynomial, t: Fraction) -> Fraction:
    value = Fraction(0)
    for c in reversed(p):
        value = value * t + c
    return value


def _remainder(p: Polynomial, q: Polynomial) -> Polynomial:
    p = list(p)
    while len(p) >= len(q):
        factor = p[-1] / q[-1]
        shift = len(p) - len(q)
        p = _trim([c - factor * q[i - shift] if i >= shift else c for i, c in enumerate(p)][:-1])
    return p


def _sturm(p: Polynomial) -> list[Polynomial]:
    chain = [p, _trim([k * c for k, c in enumerate(p)][1:])]
    while chain[-1]:
        chain.append([-c for c in _remainder(chain[-2], chain[-1])])
    return chain[:-1]


def _changes(chain: list[Polynomial], t: Fraction) -> int:
    values = (_at(p, t) for p in chain)
    return sum((a > 0) != (b > 0) for a, b in pairwise(v for v in values if v != 0))


def _isolated(p: Polynomial, low: Fraction, high: Fraction) -> list[tuple[Fraction, Fraction]]:
    """Intervals (low, high], one root each, ascending; a root at ``low`` as the interval of none.

    Intervals of a multiple root are as good: the chain counts distinct roots.
    """
    if len(p) < 2:
        return []
    chain = _sturm(p)
    found = [(low, low)] if _at(p, low) == 0 else []
    stack = [(low, high)]
    while stack:
        a, b = stack.pop()
        count = _changes(chain, a) - _changes(chain, b)
        if count == 1:
            found.append((a, b))
        elif count > 1:
            middle = (a + b) / 2
            stack += [(middle, b), (a, middle)]
    return sorted(found)


def _not_negative_at_root(g: Polynomial, f: Polynomial, low: Fraction, high: Fraction) -> bool:
    """Whether g >= 0 at the only root of f in (low, high]; a root of both counts."""
    if low == high or not g:
        return _at(g, high) >= 0
    chain_f, chain_g = _sturm(f), _sturm(g)
    for _ in range(_REFINEMENTS):
        if _at(g, low) != 0 and _changes(chain_g, low) == _changes(chain_g, high):
            return _at(g, high) > 0
        middle = (low + high) / 2
        if _changes(chain_f, low) != _changes(chain_f, middle):
            high = middle
        else:
            low = middle
    return True


def _sub(a: Vector, b: Vector) -> Vector:
    return [_add(x, y, -1) for x, y in zip(a, b, strict=True)]


def _dot(a: Vector, b: Vector) -> Polynomial:
    out: Polynomial = []
    for x, y in zip(a, b, strict=True):
        out = _add(out, _times(x, y))
    return out


def _cross(a: Vector, b: Vector) -> Vector:
    return [
        _add(_times(a[(k + 1) % 3], b[(k + 2) % 3]), _times(a[(k + 2) % 3], b[(k + 1) % 3]), -1)
        for k in range(3)
    ]


def earliest_contact(kind: int, x: Array, dx: Array) -> tuple[float, float] | None:
    """Bounds of the earliest time in [0, 1] at which the primitives touch, None without a contact.

    ``x``, ``dx``: [4, 3]. Contacts while the triangle has no area, or the edges are parallel, are
    not looked for.
    """
    motions = fractions(np.stack([x, dx], axis=-1)).tolist()
    nodes = [[_trim(motion) for motion in node] for node in motions]
    zero, one = Fraction(0), Fraction(1)
    if kind == POINT_TRIANGLE:
        p, a, b, c = nodes
        normal = _cross(_sub(b, a), _sub(c, a))
        height = _dot(normal, _sub(p, a))
        conditions = [
            _dot(normal, _cross(_sub(v, u), _sub(p, u))) for u, v in ((a, b), (b, c), (c, a))
        ]
    else:
        a0, a1, b0, b1 = nodes
        u, v, r = _sub(a1, a0), _sub(b1, b0), _sub(b0, a0)
        normal = _cross(u, v)
        height = _dot(normal, r)
        size = _dot(normal, normal)
        s, t = _dot(normal, _cross(r, v)), _dot(normal, _cross(r, u))
        conditions = [s, _add(size, s, -1), t, _add(size, t, -1)]
    area = _dot(normal, normal)

    def touching(f: Polynomial, low: Fraction, high: Fraction) -> bool:
        minus_area = [-c for c in area]
        return not _not_negative_at_root(minus_area, f, low, high) and all(
            _not_negative_at_root(g, f, low, high) for g in conditions
        )

    if height:
        for low, high in _isolated(height, zero, one):
            if touching(height, low, high):
                return float(low), float(high)
        return None
    # Coplanar for ever: the contact begins at the start or where a condition changes sign.
    if _at(area, zero) > 0 and all(_at(g, zero) >= 0 for g in conditions):
        return 0.0, 0.0
    events = [(at, g) for g in conditions for at in _isolated(g, zero, one)]
    return min([(float(at[0]), float(at[1])) for at, g in events if touching(g, *at)], default=None)
