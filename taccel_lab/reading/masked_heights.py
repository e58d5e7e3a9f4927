# SPDX-License-Identifier: Apache-2.0
"""Heights of places behind a mask, as sums over the slopes of the points that count.

The heights that slopes are integrated to solve a Laplacian whose edges are weighted by the mask
(``slope_integration``). It is symmetric: the shares of all slopes in one place's height are the
flows that a source in this place makes. Sources in all places are solved for together, by
elimination of one row of points after another.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.reading.slope_integration import MIN_WEIGHT

GROUND = 1e-9
"""Part of an edge's weight by which every point is held: a height over nothing has no solution."""


def shares_of_slopes(
    places: np.ndarray, trust: np.ndarray, steps_m: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Share of each point's slope along x, then along y, in the height of each place over the mean
    [m], shape [place, rows, columns].

    Args:
        places: Weights of points that each place is the mean of, shape [place, rows, columns].
        trust: Part of each point that counts, 0 to 1, shape [rows, columns].
        steps_m: Distance of neighbouring points along x and y [m].
    """
    least = (
        np.minimum(trust[:, 1:], trust[:, :-1]) / steps_m[0] ** 2,
        np.minimum(trust[1:], trust[:-1]) / steps_m[1] ** 2,
    )
    held = [np.maximum(w, MIN_WEIGHT * w.max()) for w in least]
    sources = places - places.mean(axis=(1, 2), keepdims=True)
    found = _solved(sources, held[0], held[1])
    flows = (
        least[0] * steps_m[0] * np.diff(found, axis=2),
        least[1] * steps_m[1] * np.diff(found, axis=1),
    )
    # The slope of an edge is the mean of its two points'.
    ends = [(0, 0)] * 3
    both = []
    for axis, flow in zip((2, 1), flows, strict=True):
        wide = np.pad(flow, [(1, 1) if k == axis else end for k, end in enumerate(ends)])
        both.append(0.5 * (np.take(wide, range(wide.shape[axis] - 1), axis)
                           + np.take(wide, range(1, wide.shape[axis]), axis)))  # fmt: skip
    return both[0], both[1]


def _solved(sources: np.ndarray, across: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Potentials of sources, both of shape [place, rows, columns], by weights of edges along rows,
    [rows, columns - 1], and from row to row, [rows - 1, columns]."""
    count, columns = sources.shape[1:]
    own = np.zeros((count, columns))
    own[:, 1:] += across
    own[:, :-1] += across
    own[1:] += down
    own[:-1] += down
    inverses, pulled = [], []
    # The rows before give this one a source, and hold it less.
    source, less = sources[:, 0].T, np.zeros((columns, columns))
    for row in range(count):
        here = np.diag(own[row] * (1.0 + GROUND)) - less
        here -= np.diag(across[row], 1) + np.diag(across[row], -1)
        inverses.append(np.linalg.inv(here))
        pulled.append(source)
        if row < count - 1:
            edge = down[row]
            source = sources[:, row + 1].T + edge[:, None] * (inverses[row] @ source)
            less = edge[:, None] * inverses[row] * edge
    found = np.empty_like(sources)
    after = np.zeros_like(source)
    for row in reversed(range(count)):
        after = inverses[row] @ (pulled[row] + after)
        found[:, row] = after.T
        if row:
            after = down[row - 1][:, None] * after
    return found
