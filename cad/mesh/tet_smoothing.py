# SPDX-License-Identifier: Apache-2.0
"""Moves free nodes of a tet mesh so that its worst tets become rounder; connectivity stays.

The energy of a tet is its inverse mean ratio sum(l^2) / (12 (3 V)^(2/3)), 1 for the regular tet
(Liu and Joe, BIT 34 (1994) 268), to a power that makes the worst ones count. It grows without bound
as a tet flattens, and steps that turn one inside out are refused, so a valid mesh stays valid.
"""

from __future__ import annotations

import numpy as np

from cad.mesh.quality_measures import dihedral_angles_deg

_POWER = 4
_NEIGHBOURHOOD = 2
_PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def improve_worst_tets(
    nodes_mm: np.ndarray,
    tets: np.ndarray,
    free: np.ndarray,
    *,
    wanted_deg: float,
    rounds: int = 3,
    iterations: int = 40,
) -> np.ndarray:
    """Move the nodes listed in ``free`` until no tet has a dihedral angle below ``wanted_deg``.

    Only nodes within two tets of one that is too flat move, at most ``rounds`` times. Tets must
    have positive volume. Returns new positions [mm], shape [n, 3]; the smallest angle never falls.
    """
    nodes = np.array(nodes_mm, dtype=np.float64)
    movable = np.zeros(len(nodes), dtype=bool)
    movable[free] = True
    for _ in range(rounds):
        smallest = dihedral_angles_deg(nodes, tets).min(axis=1)
        if smallest.min() >= wanted_deg:
            break
        near = np.zeros(len(nodes), dtype=bool)
        near[tets[smallest < wanted_deg]] = True
        for _ in range(_NEIGHBOURHOOD - 1):
            near[tets[near[tets].any(axis=1)]] = True
        moved = _minimise(nodes, tets, np.flatnonzero(near & movable), iterations)
        if dihedral_angles_deg(moved, tets).min() <= smallest.min():
            break
        nodes = moved
    return nodes


def _minimise(nodes: np.ndarray, tets: np.ndarray, free: np.ndarray, iterations: int) -> np.ndarray:
    from scipy.optimize import minimize

    if len(free) == 0:
        return nodes
    chosen = np.zeros(len(nodes), dtype=bool)
    chosen[free] = True
    patch = tets[chosen[tets].any(axis=1)]
    # Nodes move in units of their own shortest edge, so that fine and coarse parts move together.
    unit = np.full(len(nodes), np.inf)
    for a, b in _PAIRS:
        length = np.linalg.norm(nodes[patch[:, a]] - nodes[patch[:, b]], axis=1)
        np.minimum.at(unit, patch[:, a], length)
        np.minimum.at(unit, patch[:, b], length)
    scale = unit[free][:, None]

    def energy(steps: np.ndarray) -> tuple[float, np.ndarray]:
        moved = nodes.copy()
        moved[free] += steps.reshape(-1, 3) * scale
        value, gradient = _shape_energy(moved, patch)
        return value, (gradient[free] * scale).ravel()

    found = minimize(
        energy, np.zeros(3 * len(free)), jac=True, method="L-BFGS-B",
        options={"maxiter": iterations, "maxcor": 12},
    )  # fmt: skip
    moved = nodes.copy()
    moved[free] += found.x.reshape(-1, 3) * scale
    return moved


def _shape_energy(nodes: np.ndarray, tets: np.ndarray) -> tuple[float, np.ndarray]:
    """Sum of inverse mean ratios to the power 4 and its gradient by the nodes, shape [n, 3]."""
    p = nodes[tets]
    a, b, c = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], p[:, 3] - p[:, 0]
    by_corner = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    six_volumes = (a * by_corner[:, 0]).sum(axis=1)
    if six_volumes.min() <= 0:
        return np.inf, np.zeros_like(nodes)
    centered = p - p.mean(axis=1, keepdims=True)
    # The six squared edges add up to four times the squares about the centre.
    squares = 4 * (centered**2).sum(axis=(1, 2))
    ratio = squares / (12 * (0.5 * six_volumes) ** (2 / 3))
    outer = _POWER * ratio ** (_POWER - 1)
    by_square = (outer * ratio / squares)[:, None, None] * 8 * centered
    by_volume = (-2 / 3 * outer * ratio / six_volumes)[:, None, None] * by_corner
    by_square[:, 1:] += by_volume
    by_square[:, 0] -= by_volume.sum(axis=1)
    flat, corners = by_square.reshape(-1, 3), tets.ravel()
    gradient = np.stack([np.bincount(corners, flat[:, k], len(nodes)) for k in range(3)], axis=1)
    return float((ratio**_POWER).sum()), gradient
