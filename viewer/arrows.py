# SPDX-License-Identifier: Apache-2.0
"""Forces as arrows: by node, or added up over patches of the face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST_SHARE = 0.01
"""Arrows shorter than this part of the longest are left out."""


@dataclass(frozen=True)
class Forces:
    """Forces and where they act."""

    at_mm: np.ndarray
    """[arrow, 3]."""
    forces_n: np.ndarray
    """[arrow, 3]."""

    def largest_n(self) -> float:
        """Of their magnitudes; 0 without a force."""
        return float(np.linalg.norm(self.forces_n, axis=1).max(initial=0.0))


def patch_forces(positions_mm: np.ndarray, forces_n: np.ndarray, patches: int) -> Forces:
    """Forces of nodes added up over squares in xy, ``patches`` along the longer side of the gel.

    Each acts at the mean of its nodes, weighted by their forces; the sum is that of the nodes.

    Args:
        positions_mm: Nodes, [node, 3].
        forces_n: [node, 3].
        patches: At least 1.
    """
    low, high = positions_mm[:, :2].min(axis=0), positions_mm[:, :2].max(axis=0)
    side = float((high - low).max()) / patches
    touched = np.flatnonzero(np.linalg.norm(forces_n, axis=1) > 0)
    cell = np.floor((positions_mm[touched, :2] - low) / max(side, 1e-12)).astype(np.int64)
    _, index = np.unique(cell[:, 0] * (patches + 1) + cell[:, 1], return_inverse=True)
    count = int(index.max(initial=-1)) + 1
    weights = np.linalg.norm(forces_n[touched], axis=1)
    at, total, weight = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    np.add.at(at, index, weights[:, None] * positions_mm[touched])
    np.add.at(total, index, forces_n[touched])
    np.add.at(weight, index, weights)
    return Forces(at / np.maximum(weight, 1e-30)[:, None], total)


def arrow_lines(forces: Forces, mm_per_n: float, *, onto: bool) -> np.ndarray:
    """Start and end of each arrow [mm], [arrow, 2, 3], without the shortest.

    Args:
        forces: What is shown.
        mm_per_n: Length of an arrow of 1 N.
        onto: Arrows end where their force acts, as those of a tool that pushes; else begin there.
    """
    size = np.linalg.norm(forces.forces_n, axis=1)
    shown = size > LEAST_SHARE * forces.largest_n()
    at, along = forces.at_mm[shown], mm_per_n * forces.forces_n[shown]
    return np.stack([at - along, at] if onto else [at, at + along], axis=1)


def round_length(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is at most ``value`` (above 0)."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(k * power for k in (1, 2, 5) if k * power <= value * (1 + 1e-9)))
