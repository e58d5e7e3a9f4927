# SPDX-License-Identifier: Apache-2.0
"""Pads whose contact face is a height map over a flat glued back, and what they have in common."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property

import numpy as np

from taccel_lab.cad.parts.pad import Pad
from taccel_lab.cad.parts.pad_outline import PadOutline
from taccel_lab.cad.parts.rim_fillet import FilletArc, fillet_arc, fillet_height_mm
from taccel_lab.errors import InputError

MIN_WALL_MM = 0.3
"""Least height of the wall above the glued back [mm]: thinner edges tear and mesh badly."""
MIN_WINDOW_MARGIN_MM = 0.2
"""Least distance between the window and the outline [mm]."""
_SLOPE_STEP_MM = 1e-4


class HeightPad(Pad):
    """A pad with an outline, a top z = height(x, y), a wall and a back at z = -thickness."""

    window_x_mm: float
    """Window (the part of the back that the camera sees) along x [mm], centred."""
    window_y_mm: float
    skin_top_mm: float = 0.0
    """Thickness of the skin on the contact face, measured along z [mm]; 0 without one."""
    skin_side_mm: float = 0.0
    """Thickness of the skin on the wall [mm]; 0 without one."""

    @cached_property
    @abstractmethod
    def outline(self) -> PadOutline:
        """Outline in plan."""

    @abstractmethod
    def crown_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        """Height of the crown without its rim [mm], at most 0, [..., 2] -> [...]."""

    @abstractmethod
    def crown_slope(self, xy_mm: np.ndarray) -> np.ndarray:
        """Gradient of the crown (dh/dx, dh/dy), [..., 2] -> [..., 2]."""

    def height_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        """Height of the contact face with its rim [mm] (z in the gel frame), [..., 2] -> [...].

        Here that of the crown, with a fillet where there is one.
        """
        if not self.has_fillet:
            return self.crown_mm(xy_mm)
        radius = self.rim_setback_mm()
        return fillet_height_mm(self.outline, radius, self.crown_mm, self.crown_slope, xy_mm)

    def fillet_arc(self, edge_mm: np.ndarray) -> FilletArc:
        """Arcs of the fillet at points on the outline [mm], shape [n, 2]."""
        radius = self.rim_setback_mm()
        return fillet_arc(self.outline, radius, self.crown_mm, self.crown_slope, edge_mm)

    @abstractmethod
    def rim_setback_mm(self) -> float:
        """Greatest width of the rim band in plan [mm]; 0 without a rim."""

    @property
    def has_fillet(self) -> bool:
        """True when the rim is tangent to the wall."""
        return False

    @property
    def sides_bonded(self) -> bool:
        """True when the wall is glued to the housing, too."""
        return False

    @property
    def layer_names(self) -> tuple[str, ...]:  # type: ignore[override]  # depends on the values
        """Materials of the body by layer index."""
        return ("gel", "skin") if self.skin_top_mm else ("gel",)

    def inside_distance_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        return self.outline.inside_distance_mm(xy_mm)

    def min_wall_mm(self) -> float:
        """Least height of the wall above the glued back [mm]."""
        length = np.linspace(0, self.outline.perimeter_mm, 512, endpoint=False)
        ends = np.concatenate([self.outline.at_mm(length)[0], self.outline.points_mm()])
        return float(self.thickness_mm + self.height_mm(ends).min())

    def bounds_mm(self) -> np.ndarray:
        low, high = self.outline.bounds_mm()
        return np.array([[*low, -self.thickness_mm], [*high, 0.0]])

    def top_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        inside = self.inside_distance_mm(xy_mm) >= 0
        return np.where(inside, self.height_mm(xy_mm), np.nan)

    def top_normal(self, xy_mm: np.ndarray) -> np.ndarray:
        xy = np.asarray(xy_mm, dtype=np.float64)
        steps = _SLOPE_STEP_MM * np.eye(2)
        slopes = [
            (self.height_mm(xy + step) - self.height_mm(xy - step)) / (2 * _SLOPE_STEP_MM)
            for step in steps
        ]
        normal = np.stack([-slopes[0], -slopes[1], np.ones_like(slopes[0])], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return np.where(self.inside_distance_mm(xy)[..., None] >= 0, normal, np.nan)

    def contact_error_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """Vertical distance of points from the contact face's formula [mm], [n, 3] -> [n]."""
        return np.abs(points_mm[:, 2] - self.height_mm(points_mm[:, :2]))

    def bond_projection_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """Closest points on the plane z = -thickness or, when glued, the wall; [n, 3] -> [n, 3]."""
        points = np.asarray(points_mm, dtype=np.float64)
        moved = points.copy()
        moved[:, 2] = -self.thickness_mm
        if not self.sides_bonded:
            return moved
        distance = self.inside_distance_mm(points[:, :2])
        on_wall = points.copy()
        on_wall[:, :2] += distance[:, None] * self.outline.outward_normal(points[:, :2])
        nearer = np.abs(distance) < np.abs(points[:, 2] + self.thickness_mm)
        return np.where(nearer[:, None], on_wall, moved)

    def layer_of(self, points_mm: np.ndarray) -> np.ndarray:
        """0 in the gel proper, 1 in the skin, int32, [n, 3] -> [n]."""
        points = np.asarray(points_mm, dtype=np.float64)
        if not self.skin_top_mm:
            return np.zeros(len(points), dtype=np.int32)
        xy = points[:, :2]
        beside = self.inside_distance_mm(xy) < self.skin_side_mm
        above = points[:, 2] > self.height_mm(xy) - self.skin_top_mm
        return (beside | above).astype(np.int32)

    def figures(self) -> dict[str, float]:
        """What a drawing states beside the parameters [mm]."""
        corner = np.array([[self.window_x_mm / 2, self.window_y_mm / 2]])
        return {
            "wall_height_min": self.min_wall_mm(),
            "crown_drop_at_window_corner": -float(self.crown_mm(corner)[0]),
        }

    def _check_wall(self) -> None:
        wall = self.min_wall_mm()
        if wall < MIN_WALL_MM:
            raise InputError(
                f"the crown and rim drop {self.thickness_mm - wall:.3f} mm at the lowest point of "
                f"the edge and leave {wall:.3f} mm of wall; thickness_mm must be at least "
                f"{self.thickness_mm - wall + MIN_WALL_MM:.3f} mm, or the crown radii larger"
            )

    def _check_window(self) -> None:
        size = np.array([self.window_x_mm, self.window_y_mm]) / 2
        corners = size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        margin = float(self.inside_distance_mm(corners).min()) - self.skin_side_mm
        if margin < MIN_WINDOW_MARGIN_MM:
            low, high = self.outline.bounds_mm()
            edge = "skin inside the outline" if self.skin_side_mm else "outline"
            raise InputError(
                f"window_x_mm x window_y_mm = {self.window_x_mm:g} x {self.window_y_mm:g} mm comes "
                f"within {margin:.3f} mm of the {edge} {high[0] - low[0]:g} x "
                f"{high[1] - low[1]:g} mm; allowed: at least {MIN_WINDOW_MARGIN_MM} mm away"
            )
