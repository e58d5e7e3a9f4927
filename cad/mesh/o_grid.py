# SPDX-License-Identifier: Apache-2.0
"""Shapes that every O-grid shares: its bulged square core and the radii of its rings."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

_BULGE = 0.45


def spoke_angles(core: int) -> np.ndarray:
    """Angles of the ring nodes [rad], the first at the core's corner (-, -), shape [4 core]."""
    return -0.75 * np.pi + 2 * np.pi * np.arange(4 * core) / (4 * core)


def ring_radii(start: np.ndarray, edge: float, even: int, rings: int) -> np.ndarray:
    """Radius of every ring in the disc along every spoke, shape [rings, spokes]; the last is 1.

    The first ``even`` rings lead from ``start`` to ``edge`` in equal steps; the others grow by one
    factor.
    """
    inner = start + (edge - start) * np.arange(1, even + 1)[:, None] / even
    step = (edge - float(start.mean())) / even
    powers = np.arange(1, rings - even + 1)
    low, high = 0.05, 50.0
    for _ in range(80):
        growth = 0.5 * (low + high)
        low, high = (low, growth) if (step * growth**powers).sum() > 1 - edge else (growth, high)
    outer = edge + np.cumsum(step * low**powers)
    return np.concatenate([inner, np.tile(outer[:, None], (1, len(start)))])


def bulged_radius(theta: np.ndarray) -> np.ndarray:
    """Edge of a unit square (half width 1) bulged towards a circle, in polar form."""
    square = 1 / np.maximum(np.abs(np.cos(theta)), np.abs(np.sin(theta)))
    return (1 - _BULGE) * square + _BULGE * 1.12


@lru_cache(maxsize=16)
def bulged_core(core: int) -> np.ndarray:
    """Nodes of the unit core, equal angles on its edge, Coons patch inside: [n+1, n+1, 2]."""
    theta = -0.75 * np.pi + 0.5 * np.pi * np.arange(core + 1) / core
    sides = []
    for k in range(4):
        a = theta + k * np.pi / 2
        sides.append(bulged_radius(a)[:, None] * np.stack([np.cos(a), np.sin(a)], axis=-1))
    low_y, high_x, high_y, low_x = sides[0], sides[1], sides[2][::-1], sides[3][::-1]
    t = np.linspace(0, 1, core + 1)
    u, v = t[:, None, None], t[None, :, None]
    ruled = (1 - v) * low_y[:, None] + v * high_y[:, None]
    ruled += (1 - u) * low_x[None, :] + u * high_x[None, :]
    corner = (1 - u) * ((1 - v) * low_y[0] + v * high_y[0])
    corner += u * ((1 - v) * low_y[-1] + v * high_y[-1])
    return ruled - corner
