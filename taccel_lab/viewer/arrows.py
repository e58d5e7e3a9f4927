# SPDX-License-Identifier: Apache-2.0
"""Forces as arrows: of each node, or of the traction on squares of the face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST_SHARE = 0.01
"""Arrows shorter than this part of the longest are left out."""
CUTS = 6
"""Parts of a face's sides, into which its traction is cut."""


@dataclass(frozen=True)
class Forces:
    """Forces and where they act."""

    at_mm: np.ndarray
    """[arrow, 3]."""
    forces_n: np.ndarray
    """[arrow, 3]."""

    def largest_n(self) -> float:
        """Largest of their magnitudes; 0 without a force."""
        return float(np.linalg.norm(self.forces_n, axis=1).max(initial=0.0))


def patch_forces(
    positions_mm: np.ndarray, faces: np.ndarray, forces_n: np.ndarray, patches: int
) -> Forces:
    """Forces of nodes as traction of their faces, added up over squares in xy that do not move,
    ``patches`` along the longer side of the gel.

    A node's force is spread over the faces around it by their area, in each face by the node's hat
    function, so that the arrows of one traction are the same on another mesh. Arrows start in the
    middles of the squares; their sum is that of the nodes.

    Args:
        positions_mm: Nodes, [node, 3].
        faces: Triangles of the skin, [face, 3]; a force on a node of none acts at the node.
        forces_n: [node, 3].
        patches: At least 1.
    """
    points, parts = _spread(positions_mm, faces, forces_n)
    low, high = positions_mm[:, :2].min(axis=0), positions_mm[:, :2].max(axis=0)
    side = max(float((high - low).max()) / patches, 1e-12)
    cell = np.clip(np.floor((points[:, :2] - low) / side), 0, patches - 1).astype(np.int64)
    cells, index = np.unique(cell[:, 0] * patches + cell[:, 1], return_inverse=True)
    weights = np.linalg.norm(parts, axis=1)
    height, total, weight = np.zeros(len(cells)), np.zeros((len(cells), 3)), np.zeros(len(cells))
    np.add.at(height, index, weights * points[:, 2])
    np.add.at(total, index, parts)
    np.add.at(weight, index, weights)
    middles = low + (np.stack(np.divmod(cells, patches), axis=1) + 0.5) * side
    return Forces(np.column_stack([middles, height / np.maximum(weight, 1e-30)]), total)


def _spread(
    positions_mm: np.ndarray, faces: np.ndarray, forces_n: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points on faces, [n, 3], and their parts of the nodes' forces, [n, 3]."""
    loaded = np.linalg.norm(forces_n, axis=1) > 0
    touched = faces[loaded[faces].any(axis=1)]
    a, b, c = (positions_mm[touched[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    around = np.zeros(len(positions_mm))
    np.add.at(around, touched.ravel(), np.repeat(area, 3))
    # Middles of equal triangles: hat functions there are barycentric coordinates.
    hats = _middles()
    shares = hats / hats.sum(axis=0)
    # [face, corner, 3]: what each face has of its corners' forces.
    part = area[:, None, None] * (forces_n / np.maximum(around, 1e-30)[:, None])[touched]
    points = np.einsum("pc,fcd->fpd", hats, positions_mm[touched])
    parts = np.einsum("pc,fcd->fpd", shares, part)
    alone = loaded & (around == 0)
    return (
        np.concatenate([points.reshape(-1, 3), positions_mm[alone]]),
        np.concatenate([parts.reshape(-1, 3), forces_n[alone]]),
    )


def _middles() -> np.ndarray:
    """Barycentric middles of the ``CUTS**2`` equal triangles of a triangle, [n, 3]."""
    found = []
    for i in range(CUTS):
        for j in range(CUTS - i):
            found.append((i + 1 / 3, j + 1 / 3))
            if i + j < CUTS - 1:
                found.append((i + 2 / 3, j + 2 / 3))
    first, second = np.array(found).T / CUTS
    return np.stack([first, second, 1 - first - second], axis=1)


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
