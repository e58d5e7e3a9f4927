# SPDX-License-Identifier: Apache-2.0
"""Heights of a triangle surface along a line, seen from above: the section of the mesh itself.

Nothing is smoothed: beside the edge of a tool a smooth surface through the same nodes would swing.
"""

from __future__ import annotations

import numpy as np

_EDGES = ((0, 1), (1, 2), (2, 0))


def section_heights(points_m: np.ndarray, faces: np.ndarray, x_m: np.ndarray) -> np.ndarray:
    """Heights z [m] over the line y = 0 at ``x_m``, ascending, [n]; NaN beside the surface.

    ``points_m``: [node, 3]; ``faces``: [face, 3]. Where faces lie above one another the highest.
    """
    heights = np.full(len(x_m), -np.inf)
    y = points_m[faces, 1]
    across = (y.min(axis=1) <= 0) & (y.max(axis=1) >= 0)
    for face in faces[across]:
        ends = []
        for edge in _EDGES:
            # In the order of the nodes, so that neighbours end at the same bits.
            a, b = points_m[np.sort(face[list(edge)])]
            if a[1] != b[1] and min(a[1], b[1]) <= 0 <= max(a[1], b[1]):
                ends.append(a + a[1] / (a[1] - b[1]) * (b - a))
        if not ends:
            continue
        (x0, _, z0), *_, (x1, _, z1) = sorted(ends, key=lambda end: end[0])
        here = slice(np.searchsorted(x_m, x0), np.searchsorted(x_m, x1, "right"))
        share = (x_m[here] - x0) / (x1 - x0) if x1 > x0 else np.zeros(len(x_m[here]))
        heights[here] = np.maximum(heights[here], z0 + share * (z1 - z0))
    return np.where(np.isfinite(heights), heights, np.nan)
