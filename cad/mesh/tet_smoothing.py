# SPDX-License-Identifier: Apache-2.0
"""Moves free nodes of a tet mesh so that its worst tets become rounder; connectivity stays.

The energy of a tet is its inverse mean ratio sum(l^2) / (12 (3 V)^(2/3)), 1 for the regular tet
(Liu and Joe, BIT 34 (1994) 268), to a power that makes the worst ones count. It grows without bound
as a tet flattens, and steps that turn one inside out are rejected, so a valid mesh stays valid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from taccel_lab.cad.mesh.plan_smoothing import descend
from taccel_lab.cad.mesh.quality_measures import dihedral_angles_deg
from taccel_lab.geometry.tet_mesh import tet_volumes

_NEIGHBOURHOOD = 2
_SOFTNESS = 2e-2
_PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


@dataclass(frozen=True)
class SurfaceSheet:
    """A height map on which some nodes slide."""

    nodes: np.ndarray
    """Their indices; only x and y of them may be free."""
    height_mm: Callable[[np.ndarray], np.ndarray]
    """[n, 2] -> [n] [mm]."""
    step_mm: float = 1e-5

    def slope(self, xy_mm: np.ndarray) -> np.ndarray:
        """Gradient of the height by central differences, shape [n, 2]."""
        steps = self.step_mm * np.eye(2)[:, None]
        # One call for all of them: a patch has so few nodes that calls are what takes time.
        heights = self.height_mm(np.concatenate([xy_mm + steps, xy_mm - steps]).reshape(-1, 2))
        ahead, behind = heights.reshape(2, 2, -1)
        return (ahead - behind).T / (2 * self.step_mm)


def improve_worst_tets(
    nodes_mm: np.ndarray,
    tets: np.ndarray,
    free: np.ndarray,
    *,
    wanted_deg: float,
    powers: tuple[int, ...] = (4, 4, 4),
    iterations: int = 40,
    sheet: SurfaceSheet | None = None,
) -> np.ndarray:
    """Move free nodes until no tet has a dihedral angle below ``wanted_deg``.

    ``free`` lists nodes, or says by coordinate what may move, bool, shape [n, 3]; nodes on
    ``sheet`` stay on it. Only nodes within two tets of one that is too flat move, once for each
    power of the energy: the higher, the more the worst tets count. Tets that are inside out are
    pulled open first, if they can. Returns new positions [mm], shape [n, 3]; the smallest angle
    never falls, and no tet is turned inside out.
    """
    nodes = np.array(nodes_mm, dtype=np.float64)
    movable = free
    if free.dtype != bool:
        movable = np.zeros(nodes.shape, dtype=bool)
        movable[free] = True
    best, best_deg = nodes, -1.0
    for power in (*powers, 0):
        smallest = np.where(
            tet_volumes(nodes, tets) > 0, dihedral_angles_deg(nodes, tets).min(axis=1), 0.0
        )
        if smallest.min() > best_deg:
            best, best_deg = nodes, float(smallest.min())
        if best_deg >= wanted_deg or not power:
            break
        near = np.zeros(len(nodes), dtype=bool)
        near[tets[smallest < wanted_deg]] = True
        for _ in range(_NEIGHBOURHOOD - 1):
            near[tets[near[tets].any(axis=1)]] = True
        nodes = _minimise(nodes, tets, near[:, None] & movable, power, iterations, sheet)
    return best


def _minimise(
    nodes: np.ndarray,
    tets: np.ndarray,
    free: np.ndarray,
    power: int,
    iterations: int,
    sheet: SurfaceSheet | None,
) -> np.ndarray:
    chosen = np.asarray(free.any(axis=1))
    if not chosen.any():
        return nodes
    patch = tets[chosen[tets].any(axis=1)]
    volumes = 6 * tet_volumes(nodes, patch)
    # Zero for a valid mesh: its energy is infinite where a tet is flat.
    softness = 0.0 if volumes.min() > 0 else _SOFTNESS * float(np.median(np.abs(volumes)))
    # Nodes move in units of their own shortest edge, so that fine and coarse parts move together.
    unit = np.full(len(nodes), np.inf)
    for a, b in _PAIRS:
        length = np.linalg.norm(nodes[patch[:, a]] - nodes[patch[:, b]], axis=1)
        np.minimum.at(unit, patch[:, a], length)
        np.minimum.at(unit, patch[:, b], length)
    scale = np.broadcast_to(unit[:, None], nodes.shape)[free]
    held = None if sheet is None else sheet.nodes[free[sheet.nodes].any(axis=1)]

    def place(steps: np.ndarray) -> np.ndarray:
        moved = nodes.copy()
        moved[free] += steps * scale
        if sheet is not None:
            moved[held, 2] = sheet.height_mm(moved[held, :2])
        return moved

    def energy(steps: np.ndarray) -> tuple[float, np.ndarray]:
        moved = place(steps)
        value, gradient = shape_energy(moved, patch, power, softness)
        if sheet is not None:
            gradient[held, :2] += gradient[held, 2:] * sheet.slope(moved[held, :2])
        return value, gradient[free] * scale

    return place(descend(energy, len(scale), iterations))


def shape_energy(
    nodes: np.ndarray, tets: np.ndarray, power: int, softness: float = 0.0
) -> tuple[float, np.ndarray]:
    """Sum of inverse mean ratios to a power and its gradient by the nodes, shape [n, 3].

    With a ``softness`` s the volume V stands for (V + sqrt(V^2 + s^2)) / 2, positive for tets that
    are inside out too (J. Escobar et al., Comput. Methods Appl. Mech. Engrg. 192 (2003) 2775).
    """
    p = nodes[tets]
    a, b, c = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], p[:, 3] - p[:, 0]
    by_corner = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    six_volumes = (a * by_corner[:, 0]).sum(axis=1)
    if softness:
        root = np.sqrt(six_volumes**2 + softness**2)
        # The second form is the same number without cancellation.
        soft = 0.5 * softness**2 / (root + np.abs(six_volumes))
        six_volumes = np.where(six_volumes > 0, 0.5 * (six_volumes + root), soft)
        by_corner *= (six_volumes / root)[:, None, None]
    elif six_volumes.min() <= 0:
        return np.inf, np.zeros_like(nodes)
    centered = p - p.mean(axis=1, keepdims=True)
    # The six squared edges add up to four times the squares about the centre.
    squares = 4 * (centered**2).sum(axis=(1, 2))
    ratio = squares / (12 * (0.5 * six_volumes) ** (2 / 3))
    outer = power * ratio ** (power - 1)
    by_square = (outer * ratio / squares)[:, None, None] * 8 * centered
    by_volume = (-2 / 3 * outer * ratio / six_volumes)[:, None, None] * by_corner
    by_square[:, 1:] += by_volume
    by_square[:, 0] -= by_volume.sum(axis=1)
    flat, corners = by_square.reshape(-1, 3), tets.ravel()
    gradient = np.stack([np.bincount(corners, flat[:, k], len(nodes)) for k in range(3)], axis=1)
    return float((ratio**power).sum()), gradient
