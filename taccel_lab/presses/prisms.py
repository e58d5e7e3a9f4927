# SPDX-License-Identifier: Apache-2.0
"""Indenters that are prisms along y, or rows of pins: roller, edge, grating, pair; closed meshes.

All are centred on the origin in x and y, and their lowest side points to -z.
"""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.scene import TriangleMesh

_BODY_M = 4e-3
"""Height of what carries the working part."""
_ROUND_SEGMENTS = 128
"""Segments of a full turn: the chords of a roller of 2 mm dip by 0.6 um."""
_TIP_SEGMENTS = 12
_PIN_SEGMENTS = 32
_PIN_RINGS = 8


def _prism(outline: np.ndarray, triangles: np.ndarray, length_m: float) -> TriangleMesh:
    """Sweep a triangulated section along y.

    ``outline``: corners (x, z) [m], [n, 2]; ``triangles``: its triangulation, counter-clockwise in
    (x, z), whose edges that belong to one triangle alone bound it, [m, 3].
    """
    n, half = len(outline), length_m / 2
    front = np.stack([outline[:, 0], np.full(n, -half), outline[:, 1]], axis=1)
    back = front + [0.0, length_m, 0.0]
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    known = {(int(a), int(b)) for a, b in edges}
    border = np.array([(a, b) for a, b in known if (b, a) not in known])
    a, b = border[np.lexsort(border.T)].T
    # Seen from -y, where x points right and z up, counter-clockwise triangles look outwards.
    faces = np.concatenate([
        triangles, triangles[:, ::-1] + n,
        np.stack([a, a + n, b + n], axis=1), np.stack([a, b + n, b], axis=1),
    ])  # fmt: skip
    return TriangleMesh(np.concatenate([front, back]), faces)


def _fan(count: int) -> np.ndarray:
    """Triangles of a convex polygon whose corners go round counter-clockwise."""
    i = np.arange(1, count - 1)
    return np.stack([np.zeros_like(i), i, i + 1], axis=1)


def roller_mesh(radius_m: float, length_m: float) -> TriangleMesh:
    """A cylinder that lies on its side, its axis along y through the origin."""
    angle = np.arange(_ROUND_SEGMENTS) * (2 * np.pi / _ROUND_SEGMENTS) - np.pi / 2
    outline = radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return _prism(outline, _fan(_ROUND_SEGMENTS), length_m)


def edge_mesh(opening_deg: float, length_m: float, radius_m: float = 0.0) -> TriangleMesh:
    """A wedge with its edge along y, pointing down; ``radius_m`` rounds the edge, 0 is sharp."""
    half = math.radians(opening_deg) / 2
    # Where the flanks leave the rounding, whose centre lies radius_m over the lowest point.
    if radius_m > 0:
        turn = np.linspace(-(np.pi / 2 - half), np.pi / 2 - half, _TIP_SEGMENTS + 1)
        tip = radius_m * np.stack([np.sin(turn), 1 - np.cos(turn)], axis=1)
    else:
        tip = np.zeros((1, 2))
    # A blunt wedge is cut off at the sides: the flanks end where it is as wide as twice its height.
    rise = min(_BODY_M, _BODY_M / math.tan(half))
    if rise <= tip[-1, 1]:
        raise InputError(
            f"an edge of {opening_deg:g} deg rounded by {radius_m * 1e3:g} mm leaves no flanks; "
            "use a smaller radius"
        )
    out = tip[-1, 0] + (rise - tip[-1, 1]) * math.tan(half)
    outline = np.concatenate([tip, [[out, rise], [-out, rise]]])
    outline[:, 1] -= rise / 2
    return _prism(outline, _fan(len(outline)), length_m)


def grating_mesh(pitch_m: float, ridges: int, length_m: float) -> TriangleMesh:
    """Parallel ridges along y, half a pitch wide and one pitch high, on a plate."""
    left = (np.arange(ridges) - (ridges - 1) / 2 - 0.25) * pitch_m
    x = np.stack([left, left + pitch_m / 2], axis=1).ravel()
    plate = max(pitch_m, 1e-3)
    low = -(pitch_m + plate) / 2
    levels = (low, low + pitch_m, low + pitch_m + plate)
    count = len(x)
    outline = np.concatenate([np.stack([x, np.full(count, z)], axis=1) for z in levels])
    strips = [(k, level) for k in range(0, count - 1, 2) for level in (0, 1)]
    strips += [(k, 1) for k in range(1, count - 1, 2)]
    triangles = []
    for k, level in strips:
        a = k + level * count
        b, c, d = a + 1, a + 1 + count, a + count
        triangles += [(a, b, c), (a, c, d)]
    return _prism(outline, np.array(triangles), length_m)


def pair_mesh(radius_m: float, gap_m: float) -> TriangleMesh:
    """Two upright pins with round tips side by side along x, ``gap_m`` between them."""
    pin = _pin(radius_m)
    offset = np.array([radius_m + gap_m / 2, 0.0, 0.0])
    vertices = np.concatenate([pin.vertices_m - offset, pin.vertices_m + offset])
    return TriangleMesh(vertices, np.concatenate([pin.faces, pin.faces + len(pin.vertices_m)]))


def _pin(radius_m: float) -> TriangleMesh:
    """A pin along z: a half sphere below, a flat end above."""
    turn = 2 * np.pi / _PIN_SEGMENTS * np.arange(_PIN_SEGMENTS)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    height = radius_m + _BODY_M
    polar = 0.5 * np.pi * np.arange(1, _PIN_RINGS + 1) / _PIN_RINGS
    loops = [(radius_m * math.sin(a), radius_m * (1 - math.cos(a))) for a in polar]
    loops.append((radius_m, height))
    vertices = [np.column_stack([r * ring, np.full(_PIN_SEGMENTS, z)]) for r, z in loops]
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height]])
    nodes = np.concatenate([*vertices, ends]) - [0.0, 0.0, height / 2]
    i = np.arange(_PIN_SEGMENTS)
    j = (i + 1) % _PIN_SEGMENTS
    tip = len(nodes) - 2
    faces = [np.stack([j, i, np.full_like(i, tip)], axis=1)]
    for k in range(len(loops) - 1):
        low, high = k * _PIN_SEGMENTS, (k + 1) * _PIN_SEGMENTS
        faces += [
            np.stack([i + low, j + low, j + high], axis=1),
            np.stack([i + low, j + high, i + high], axis=1),
        ]
    last = (len(loops) - 1) * _PIN_SEGMENTS
    faces.append(np.stack([i + last, j + last, np.full_like(i, tip + 1)], axis=1))
    return TriangleMesh(nodes, np.concatenate(faces))
