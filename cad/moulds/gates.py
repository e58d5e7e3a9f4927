# SPDX-License-Identifier: Apache-2.0
"""Where gel is poured in and air gets out: holes through the lid, over the gel's back.

Holes leave a mark, so that they keep to the faces given, such as the bonded margin beside the
window. The pour hole goes where there is most room, the vents as far from it and from each other as
can be, because air that is pushed ahead of the gel collects there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from build123d import Face, GeomType

from taccel_lab.errors import InputError

_RIM_MM = 0.1
"""Least distance of a hole from the edge of its face."""
_LEAST_DIAMETER_MM = 0.5
_GRID = 120
_EDGE_POINTS = 48


@dataclass(frozen=True)
class Gate:
    """One vertical hole through the lid."""

    kind: str
    """"pour" or "vent"."""
    at_mm: tuple[float, float]
    diameter_mm: float


def place_gates(
    faces: Sequence[Face], *, pour_mm: float, vent_mm: float, vents: int
) -> tuple[Gate, ...]:
    """Pour hole and vents over horizontal ``faces``, as large as wanted or as there is room for.

    Raises InputError when not even holes of 0.5 mm fit.
    """
    starts, ends = _segments(faces)
    points, room = _places(starts, ends)
    best = 2 * (float(room.max(initial=0)) - _RIM_MM)
    if best < _LEAST_DIAMETER_MM:
        raise InputError(
            f"the back of the gel leaves room for a pour hole of {max(best, 0):.2f} mm only; "
            f"allowed: at least {_LEAST_DIAMETER_MM} mm. Make the margin round the window wider"
        )
    # Of equally roomy places the rightmost, so that the choice does not depend on rounding.
    pour = int((room.round(2) * 1e6 + points[:, 0]).argmax())
    gates = [Gate("pour", _xy(points[pour]), min(pour_mm, best))]
    vent = min(vent_mm, max(0.6 * best, _LEAST_DIAMETER_MM))
    open_to = np.flatnonzero(room >= vent / 2 + _RIM_MM)
    distance = np.linalg.norm(points[open_to] - points[pour], axis=1)
    for _ in range(vents):
        farthest = int(distance.argmax())
        if distance[farthest] < pour_mm + vent:
            break
        place = points[open_to[farthest]]
        gates.append(Gate("vent", _xy(place), vent))
        distance = np.minimum(distance, np.linalg.norm(points[open_to] - place, axis=1))
    if len(gates) == 1:
        raise InputError("the back of the gel leaves no room for a vent beside the pour hole")
    return tuple(gates)


def _xy(point: np.ndarray) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _segments(faces: Sequence[Face]) -> tuple[np.ndarray, np.ndarray]:
    """Straight pieces of all edges of the faces in plan, shape [n, 2] twice."""
    chains = []
    for face in faces:
        for edge in face.edges():
            straight = edge.geom_type == GeomType.LINE
            t = np.linspace(0, 1, 2 if straight else _EDGE_POINTS)
            chains.append(np.array([[p.X, p.Y] for p in edge.positions(t.tolist())]))
    return (
        np.concatenate([chain[:-1] for chain in chains]),
        np.concatenate([chain[1:] for chain in chains]),
    )


def _places(starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points inside the faces on a grid, and their distances to the edges."""
    low, high = starts.min(axis=0), starts.max(axis=0)
    # Off the round fractions of the outline, so that no ray below meets a corner of it.
    fractions = (np.arange(_GRID) + 0.382) / _GRID
    axes = [a + (b - a) * fractions for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = np.zeros(len(grid), dtype=bool)
    room = np.full(len(grid), np.inf)
    for a, b in zip(starts, ends, strict=True):
        along = b - a
        t = np.clip((grid - a) @ along / max(float(along @ along), 1e-300), 0, 1)
        room = np.minimum(room, np.linalg.norm(grid - a - t[:, None] * along, axis=1))
        # Even-odd rule: a ray along +x crosses the edges an odd number of times from inside.
        if a[1] != b[1]:
            crosses = (a[1] > grid[:, 1]) != (b[1] > grid[:, 1])
            at_x = a[0] + (grid[:, 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
            inside ^= crosses & (grid[:, 0] < at_x)
    return grid[inside], room[inside]
