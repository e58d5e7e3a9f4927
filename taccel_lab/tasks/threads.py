# SPDX-License-Identifier: Apache-2.0
"""A threaded rod and nut of M20 with wide play, as closed triangle meshes of ours.

The thread is a strip of helical rows: row r of turn t lies at height pitch (t + phase_r + angle / 2
pi), so crests and roots are followed exactly. Over the first and last half turn the thread fades
to the root's radius, and ramps join the strip to flat rings at both ends.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.scene import TriangleMesh

PITCH_M = 2.5e-3
SEGMENTS = 36
BOLT = ((-0.375, 8.75e-3), (-0.0625, 10.0e-3), (0.0625, 10.0e-3), (0.375, 8.75e-3))
"""Phase [pitches] and radius [m] of the edges of root and crest; the root's come first and last."""
NUT = ((-0.890, 10.476e-3), (-0.5754, 9.191e-3), (-0.4246, 9.191e-3), (-0.110, 10.476e-3))
"""Its root faces the bolt's crest."""
APOTHEM_M = 17.7535e-3
"""Apothem of the nut's hexagon: flats look to +-x."""

Faces = list[tuple[int, int, int]]


def threaded_rod(turns: int = 27) -> TriangleMesh:
    """A rod from z = 0 up, ``turns`` pitches of thread."""
    clear = 1e-3
    first = clear + 0.5 * PITCH_M
    height = first + PITCH_M * (turns + 0.5) + clear
    points, faces, low, high = _strip(BOLT, turns, first, 7.5e-3, height)
    ends = len(points) + np.arange(2)
    n = SEGMENTS
    for i in range(n):
        j = (i + 1) % n
        faces += [(ends[0], low[j], low[i]), (ends[1], high[i], high[j])]
    points = np.concatenate([points, [(0, 0, 0), (0, 0, height)]])
    return TriangleMesh(points, np.array(faces))


def hexagon_nut(turns: int = 9) -> TriangleMesh:
    """A nut from z = 0 up; at angle 0 its thread's root is at the height PITCH_M times a whole
    number, plus a millimetre and half a pitch, as the rod's crest is."""
    clear = 1e-3
    first = clear + 1.5 * PITCH_M
    height = first + PITCH_M * turns + clear
    points, faces, low, high = _strip(NUT, turns, first, 10.9e-3, height)
    faces = [(a, c, b) for a, b, c in faces]
    n = SEGMENTS
    angles = 2 * np.pi * np.arange(n) / n
    sixth = np.pi / 3
    radius = APOTHEM_M / np.cos((angles + sixth / 2) % sixth - sixth / 2)
    outline = np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
    under, over = (len(points) + k * n + np.arange(n) for k in range(2))
    for i in range(n):
        j = (i + 1) % n
        faces += [(low[i], low[j], under[j]), (low[i], under[j], under[i])]
        faces += [(high[j], high[i], over[i]), (high[j], over[i], over[j])]
        faces += [(under[i], under[j], over[j]), (under[i], over[j], over[i])]
    rings = [np.column_stack([outline, np.full(n, z)]) for z in (0.0, height)]
    return TriangleMesh(np.concatenate([points, *rings]), np.array(faces))


def _strip(
    rows: tuple[tuple[float, float], ...], turns: int, first_m: float, ring_m: float, top_m: float
) -> tuple[np.ndarray, Faces, np.ndarray, np.ndarray]:
    """Vertices, faces that look away from the axis, and the rings at heights 0 and ``top_m``.

    ``first_m``: height of phase 0 of the first turn at angle 0. ``ring_m``: radius of the rings.
    """
    n, each = SEGMENTS, len(rows)
    last = turns * each - 1
    segment = np.arange(n) / n
    angles = 2 * np.pi * segment
    root = rows[0][1]
    points = []
    for turn in range(turns):
        fade = np.clip(2 * np.minimum(turn + segment, turns - turn - segment), 0, 1)
        for phase, full in rows:
            radius = root + fade * (full - root)
            heights = first_m + PITCH_M * (turn + phase + segment)
            points.append(
                np.column_stack([radius * np.cos(angles), radius * np.sin(angles), heights])
            )
    for z in (0.0, top_m):
        points.append(
            ring_m * np.column_stack([np.cos(angles), np.sin(angles), np.full(n, z / ring_m)])
        )
    ring = (last + 1) * n + np.arange(n)
    low, high = ring, ring + n

    def at(row: int, s: int) -> int:
        """A turn further on, a row is the one of the same phase in the next turn."""
        return (row + each * (s // n)) * n + s % n

    faces: Faces = []

    def quad(a: int, b: int, c: int, d: int) -> None:
        faces.extend([(a, b, c), (a, c, d)])

    for s in range(n):
        # The strip's last segment belongs to the turn above.
        for row in range(last if s < n - 1 else last - each):
            quad(at(row, s), at(row, s + 1), at(row + 1, s + 1), at(row + 1, s))
        quad(low[s], low[(s + 1) % n], at(0, s + 1), at(0, s))
        final = last if s < n - 1 else last - each
        quad(at(final, s), at(final, s + 1), high[(s + 1) % n], high[s])
    for k in range(each):
        faces.append((low[0], at(k, 0), at(k + 1, 0)))
        faces.append((high[n - 1], at(last - k, n - 1), at(last - k - 1, n - 1)))
    return np.concatenate(points), faces, low, high
