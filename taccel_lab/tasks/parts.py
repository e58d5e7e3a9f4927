# SPDX-License-Identifier: Apache-2.0
"""Mechanical parts as closed triangle meshes of ours, each lofted from rings of points.

All lie about their middle with their axis along z, sizes as of M8 hardware and its counterparts;
but for a threaded rod and nut of M20 with wide play, which stand on z = 0. Their thread is a strip
of helical rows: row r of turn t lies at height pitch (t + phase_r + angle / 2 pi), so crests and
roots are followed exactly. Over the first and last half turn the thread fades to the root's radius,
and ramps join the strip to flat rings at both ends.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.scene import TriangleMesh

SEGMENTS = 48
"""Sides of what is round; a multiple of six and of the gear's teeth."""


def loft(rings: np.ndarray, closed: bool = False) -> TriangleMesh:
    """The surface over rings of points [ring, n, 3], each counter-clockwise as seen from the later
    ones. Ends are closed by fans about the mean of their points, or, when ``closed``, the last ring
    is joined to the first one."""
    count, n, _ = rings.shape
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = []
    for ring in range(count if closed else count - 1):
        low, high = ring * n, (ring + 1) % count * n
        faces += [np.stack([low + i, low + j, high + j], 1)]
        faces += [np.stack([low + i, high + j, high + i], 1)]
    points = rings.reshape(-1, 3)
    if not closed:
        points = np.concatenate([points, [rings[0].mean(axis=0), rings[-1].mean(axis=0)]])
        last = (count - 1) * n
        faces += [np.stack([np.full(n, count * n), j, i], 1)]
        faces += [np.stack([np.full(n, count * n + 1), last + i, last + j], 1)]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return TriangleMesh(1e-3 * (points - middle), np.concatenate(faces))


def _angles() -> np.ndarray:
    return 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS


def _round(radius: float) -> np.ndarray:
    """Radii [mm] by angle, as are those below."""
    return np.full(SEGMENTS, radius)


def _hexagon(across: float) -> np.ndarray:
    sixth = np.pi / 3
    return across / 2 / np.cos((_angles() + sixth / 2) % sixth - sixth / 2)


def _teeth(count: int, root: float, tip: float) -> np.ndarray:
    phase = (count * _angles() / (2 * np.pi)) % 1.0
    return np.where(phase < 0.5, tip, root)


def _stack(levels: list[tuple[np.ndarray, float]], hollow: bool = False) -> TriangleMesh:
    """Outlines of radii by angle at heights [mm]; the last one joined to the first when hollow."""
    turn = np.stack([np.cos(_angles()), np.sin(_angles())], axis=1)
    rings = [np.column_stack([radii[:, None] * turn, np.full(SEGMENTS, z)]) for radii, z in levels]
    return loft(np.array(rings), hollow)


def _hollow(inner: np.ndarray, outer: np.ndarray, height: float) -> TriangleMesh:
    return _stack([(inner, height), (inner, 0.0), (outer, 0.0), (outer, height)], hollow=True)


def hex_nut() -> TriangleMesh:
    """M8: 13 mm across flats."""
    return _hollow(_round(3.4), _hexagon(13.0), 6.5)


def washer() -> TriangleMesh:
    """M8."""
    return _hollow(_round(4.2), _round(8.0), 1.6)


def bearing_ring() -> TriangleMesh:
    """An inner ring with its groove outside."""
    inner, outer, groove = _round(5.0), _round(7.5), _round(6.5)
    levels = [(inner, 6.0), (inner, 0.0), (outer, 0.0), (outer, 1.5), (groove, 2.2)]
    return _stack([*levels, (groove, 3.8), (outer, 4.5), (outer, 6.0)], hollow=True)


def gear() -> TriangleMesh:
    """Twelve straight teeth, module 1.25 mm."""
    return _hollow(_round(2.5), _teeth(12, 6.0, 8.5), 5.0)


def hex_bolt() -> TriangleMesh:
    """M8 x 14."""
    hexagon, shank = _hexagon(13.0), _round(4.0)
    return _stack([(hexagon, 0.0), (hexagon, 5.3), (shank, 5.3), (shank, 19.3)])


def socket_screw() -> TriangleMesh:
    """M8 x 10 with a cylindrical head and a hexagonal socket."""
    socket, head, shank = _hexagon(6.0), _round(6.5), _round(4.0)
    return _stack(
        [(shank, 0.0), (shank, 10.0), (head, 10.0), (head, 18.0), (socket, 18.0), (socket, 14.0)]
    )


def bushing() -> TriangleMesh:
    """Bushing with a flange."""
    bore, body, flange = _round(4.0), _round(5.5), _round(8.0)
    return _stack(
        [(bore, 10.0), (bore, 0.0), (flange, 0.0), (flange, 2.0), (body, 2.0), (body, 10.0)],
        hollow=True,
    )


def dowel() -> TriangleMesh:
    """A pin of 8 mm with chamfers."""
    ends, body = _round(3.2), _round(4.0)
    return _stack([(ends, 0.0), (body, 0.8), (body, 17.2), (ends, 18.0)])


def spring_pin() -> TriangleMesh:
    """A tube of 8 mm with a slot of 40 degrees along it."""
    angles = np.radians(np.linspace(20.0, 340.0, SEGMENTS))
    section = np.array([(3.0, 0.0), (4.0, 0.0), (4.0, 18.0), (3.0, 18.0)])[::-1]
    rings = [[(r * np.cos(a), r * np.sin(a), z) for r, z in section] for a in angles]
    return loft(np.array(rings))


def bracket() -> TriangleMesh:
    """An angle of 12 x 12 mm and 3 mm, 14 mm wide: a strip bent about its inner edge."""
    strip = [((0.0, 12.0), (3.0, 12.0)), ((0.0, 0.0), (3.0, 3.0)), ((12.0, 0.0), (12.0, 3.0))]
    rings = [
        [(*inner, 0.0), (*inner, 14.0), (*outer, 14.0), (*outer, 0.0)] for outer, inner in strip
    ]
    return loft(np.array(rings))


PARTS: dict[str, Callable[[], TriangleMesh]] = {
    "hex nut": hex_nut,
    "washer": washer,
    "bearing ring": bearing_ring,
    "gear": gear,
    "hex bolt": hex_bolt,
    "socket screw": socket_screw,
    "bushing": bushing,
    "dowel": dowel,
    "spring pin": spring_pin,
    "bracket": bracket,
}
"""Parts by name."""


PITCH_M = 2.5e-3
THREAD_SEGMENTS = 36
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
    n = THREAD_SEGMENTS
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
    n = THREAD_SEGMENTS
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
    n, each = THREAD_SEGMENTS, len(rows)
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
