# SPDX-License-Identifier: Apache-2.0
"""The section of a tool at half the depth of a press: about what of a gel it touches."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry.contact_sweep import ContactSweep

_ON_OUTLINE = 0.02
"""Distance from an outline, over the root of its area, up to which sides count as its own."""


@dataclass(frozen=True)
class ToolSection:
    """What the mesh of a press has to resolve of a tool that is no ball."""

    outline_mm: np.ndarray
    """Convex, in the tool's plane [mm], counter-clockwise, shape [n, 2]."""
    filled: float
    """Part of the outline's area that the tool fills: 1 of a punch, a half of a grating."""
    depth_mm: float
    """Depth of the press."""
    relief_mm: float = math.inf
    """Mean width of what stands out, and of what lies between, inside the outline: its area over
    the length of the sides in it. Infinite where there are none."""

    def __post_init__(self) -> None:
        outline = self.outline_mm
        if outline.ndim != 2 or outline.shape[1] != 2 or not np.isfinite(outline).all():
            raise InputError("the outline of a tool's section must be finite xy in mm, [n, 2]")
        if not (0 < self.filled <= 1 and self.depth_mm > 0):
            raise InputError(
                "a tool's section fills a part of its outline in (0, 1], at a depth above 0 mm; "
                f"got {self.filled:g} and {self.depth_mm:g} mm"
            )

    @staticmethod
    def of(vertices_m: np.ndarray, faces: np.ndarray, depth_mm: float) -> ToolSection:
        """Section of a closed surface [m] whose -z side goes first, [n, 3] and [m, 3] turning
        outwards."""
        from scipy.spatial import ConvexHull

        level = vertices_m[:, 2].min() + 0.5e-3 * depth_mm
        low = vertices_m[:, 2] <= level
        cut = faces[low[faces].any(axis=1) & ~low[faces].all(axis=1)]
        sides = _section_sides(vertices_m[cut], level)
        points = 1e3 * np.concatenate([vertices_m[low, :2], sides.reshape(-1, 2)])
        hull = ConvexHull(points)
        begin, end = 1e3 * sides[:, 0], 1e3 * sides[:, 1]
        area = 0.5 * float((begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0]).sum())
        # A tool that goes in whole has no section there: its shadow counts.
        filled = min(area / hull.volume, 1.0) if len(sides) else 1.0
        to_outline = -(0.5 * (begin + end) @ hull.equations[:, :2].T + hull.equations[:, 2])
        within = to_outline.min(axis=1, initial=math.inf) > _ON_OUTLINE * math.sqrt(hull.volume)
        length = float(np.linalg.norm(end - begin, axis=1)[within].sum())
        relief_mm = hull.volume / length if length else math.inf
        return ToolSection(points[hull.vertices], filled, depth_mm, relief_mm)

    def moved(self, sweep: ContactSweep) -> ToolSection:
        """Section at the end of the tool's way over the gel."""
        return replace(self, outline_mm=sweep.moved(self.outline_mm))


def _section_sides(corners: np.ndarray, level: float) -> np.ndarray:
    """Where triangles, [n, 3, 3], cross the plane z = ``level``: from begin to end with the inside
    on the left, xy, shape [n, 2, 2]."""
    low = corners[..., 2] <= level
    # Each triangle turned so that one corner lies alone on its side.
    alone = np.where(low.sum(axis=1) == 1, low.argmax(axis=1), (~low).argmax(axis=1))
    turned = corners[np.arange(len(corners))[:, None], (alone[:, None] + np.arange(3)) % 3]
    single, others = turned[:, :1], turned[:, 1:]
    share = (level - single[..., 2]) / (others[..., 2] - single[..., 2])
    crossing = (single + share[..., None] * (others - single))[..., :2]
    single_is_low = turned[:, 0, 2] <= level
    return np.where(single_is_low[:, None, None], crossing[:, ::-1], crossing)
