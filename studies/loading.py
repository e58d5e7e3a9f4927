# SPDX-License-Identifier: Apache-2.0
"""What force testers record besides a loading: ways back, cycles, travel through air, drift.

``first_loading`` finds the rows of the first way down. ``find_touch`` finds where it touches: the
record is a line in air and a power law from the touch on, tried at every depth by least squares.
The force that the line has at the touch is the load cell's zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

LEAST_ROWS = 5
"""Of a loading."""
NOISE = 0.05
"""Steps back, as a part of the way, that are noise."""
AIR_ROWS = 5
"""Fewer rows before the touch say nothing of a load cell's zero."""
LINE_ROWS = 10
"""Fewer give their mean, not a line."""
MARGIN = 0.1
"""Rows nearer to the touch than this part of the way behind it may be in contact."""
FORCE_FLOOR = 0.1
"""Noise grows with the force down to this part of the largest."""
DRIFT = 0.1
"""Steepest force in air, as a part of the mean slope in contact: more is contact."""
_EXPONENTS = (1.0, 1.5, 2.0, 2.5, 3.0)
"""Of force over depth: flat punches, balls on thick gels, balls on thin ones."""
_CANDIDATES, _ROWS = 60, 300
_ZOOMS = 4


@dataclass(frozen=True)
class Touch:
    """Where a loading touches."""

    depth_mm: float
    force_n: float
    """What the load cell reads there."""
    drift_n_per_mm: float
    """Of the force in air."""
    air_rows: int


def first_loading(depth: np.ndarray) -> tuple[np.ndarray, str]:
    """Rows of the first way to the greatest depth, in order of depth, and what was done."""
    rows = np.arange(len(depth))
    turns = _turns(depth, NOISE * float(np.ptp(depth)))
    keep, remark = rows, ""
    if len(turns) - 1 <= max(2, len(depth) / 8):  # More turns are no machine's.
        keep = _loading_rows(depth, turns)
        left = len(depth) - len(keep)
        cycles = "of the way back" if len(turns) <= 3 else "of ways back and later cycles"
        remark = f"{left} rows {cycles} left out" if left else ""
    if len(keep) < LEAST_ROWS:
        keep, remark = rows, "rows were not in order of depth; sorted"
    elif len(keep) == len(depth) and len(turns) > 2:
        remark = "rows were not in order of depth; sorted"
    return keep[np.argsort(depth[keep], kind="stable")], remark


def _turns(depth: np.ndarray, noise: float) -> list[int]:
    """First row, rows where the way turns by more than ``noise``, last row of the last way."""
    turns, way, far = [0], 0, 0
    for row in range(1, len(depth)):
        step = depth[row] - depth[far]
        if way == 0:
            if abs(step) > noise:
                way, far = (1 if step > 0 else -1), row
        elif step * way > 0:
            far = row
        elif -step * way > noise:
            turns.append(far)
            way, far = -way, row
    return [*turns, far]


def _loading_rows(depth: np.ndarray, turns: list[int]) -> np.ndarray:
    """Rows of ways down that go deeper than those before, to the greatest depth."""
    noise = NOISE * float(np.ptp(depth))
    found: list[int] = []
    deepest = -np.inf
    for start, end in pairwise(turns):
        if depth[end] > depth[start]:
            way = np.arange(start, end + 1)
            found += way[depth[way] >= deepest - (noise if found else 0)].tolist()
            deepest = max(deepest, float(depth[end]))
            if deepest >= depth.max() - noise:
                break
    return np.array(sorted(set(found)), dtype=int)


def find_touch(depth: np.ndarray, force: np.ndarray) -> Touch | None:
    """Where a loading, in order of depth, touches; None where it has too few rows before that."""
    touch, first = float(depth[0]), 0
    for _ in range(_ZOOMS):
        touch = _turning_point(depth[first:], force[first:])
        # Air as long as the way in the gel: a long search would leave the contact a few points.
        wanted = int(np.searchsorted(depth, touch - 1.5 * (depth[-1] - touch)))
        if wanted <= first:
            break
        first = wanted
    air = depth < touch - MARGIN * (depth[-1] - touch)
    count = int(air.sum())
    if count < AIR_ROWS or len(depth) - int((depth < touch).sum()) < LEAST_ROWS:
        return None
    slope = 0.0
    if count >= LINE_ROWS and np.ptp(depth[air]) > 0:
        slope, _ = np.polyfit(depth[air], force[air], 1)
    zero = float(force[air].mean() + slope * (touch - depth[air].mean()))
    return Touch(touch, zero, float(slope), count)


def _turning_point(depth: np.ndarray, force: np.ndarray) -> float:
    """Depth from which a line and a power law fit best."""
    x, y = _thinned(depth, force)
    top = float(np.ptp(y)) or 1.0
    weight = 1.0 / np.maximum(y - np.median(y[: max(len(y) // 10, 1)]), FORCE_FLOOR * top)
    low, high = float(x[0]), float(x[-1])
    deepest = high
    best = (np.inf, low)
    for _ in range(2):  # All of it, then about the best of that.
        step = (high - low) / _CANDIDATES
        for at in low + step * np.arange(_CANDIDATES):
            for power in _EXPONENTS:
                bent = np.clip(x - at, 0.0, None) ** power
                columns = np.stack([np.ones_like(x), x - at, bent], axis=1) * weight[:, None]
                if (x < at).sum() < AIR_ROWS:
                    columns = columns[:, [0, 2]]  # A line in air needs air.
                found, *_ = np.linalg.lstsq(columns, y * weight, rcond=None)
                rise = found[-1] * (deepest - at) ** power
                if len(found) == 3 and abs(found[1]) * (deepest - at) > DRIFT * rise:
                    continue
                cost = float(np.sum((columns @ found - y * weight) ** 2))
                if found[-1] > 0 and cost < best[0]:
                    best = (cost, float(at))
        low, high = max(best[1] - step, float(x[0])), min(best[1] + step, float(x[-1]))
    return best[1]


def _thinned(depth: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of neighbouring rows, so that there are at most ``_ROWS``."""
    size = -(-len(depth) // _ROWS)
    edges = np.arange(0, len(depth), size)
    counts = np.diff(np.append(edges, len(depth)))
    return np.add.reduceat(depth, edges) / counts, np.add.reduceat(force, edges) / counts
