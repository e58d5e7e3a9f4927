# SPDX-License-Identifier: Apache-2.0
"""Shapes that every O-grid shares: its bulged square core and the radii of its rings."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from taccel_lab.cad.mesh.grid import core_perimeter

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
    theta = spoke_angles(core)
    edge = bulged_radius(theta)[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    return coons_patch(edge, core).reshape(core + 1, core + 1, 2)


def coons_patch(loop: np.ndarray, core: int) -> np.ndarray:
    """Nodes of a core from those around it, by a Coons patch, [(core + 1)^2, 2]."""
    grid = np.zeros((core + 1, core + 1, 2))
    grid.reshape(-1, 2)[core_perimeter(core)] = loop
    u = np.linspace(0, 1, core + 1)[:, None, None]
    v = np.linspace(0, 1, core + 1)[None, :, None]
    ruled = (1 - u) * grid[:1] + u * grid[-1:] + (1 - v) * grid[:, :1] + v * grid[:, -1:]
    corner = (1 - u) * ((1 - v) * grid[0, 0] + v * grid[0, -1])
    corner = corner + u * ((1 - v) * grid[-1, 0] + v * grid[-1, -1])
    return (ruled - corner).reshape(-1, 2)
