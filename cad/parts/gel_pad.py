# SPDX-License-Identifier: Apache-2.0
"""A gel pad as formulas: rounded-rectangle outline, crowned top, rim, glued flat back.

The gel frame in millimetres: origin at the apex of the contact face, z out of the gel, the glued
back at z = -thickness. Solid, meshes and tests all read their shape from here.

The crown is the biconic sag ``(x^2/Rx + y^2/Ry) / (1 + sqrt(1 - x^2/Rx^2 - y^2/Ry^2))``, which is
an exact sphere when Rx = Ry (ISO 10110-12 with zero conic constants). A fillet is the ball rolled
along the edge between the wall and the tangent plane of the crown, exact for a plane crown.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cad.parameters import parameter
from cad.parts.pad import Pad
from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from cad.parts.labelled_solid import LabelledSolid

_NEUTRAL = "neutral value; a sensor family sets its own"
MIN_WALL_MM = 0.3
"""Least height of the wall above the glued back [mm]: thinner edges tear and mesh badly."""
MIN_WINDOW_MARGIN_MM = 0.2
"""Least distance between the window and the outline [mm]."""
_SLOPE_STEP_MM = 1e-4


@dataclass(frozen=True)
class GelPad(Pad):
    """Dimensions of one gel pad [mm]."""

    length_x_mm: float = parameter(
        24.0, minimum=4, maximum=100, unit="mm", source=_NEUTRAL, description="plan size along x"
    )
    length_y_mm: float = parameter(
        20.0, minimum=4, maximum=100, unit="mm", source=_NEUTRAL, description="plan size along y"
    )
    corner_radius_mm: float = parameter(
        2.0,
        minimum=0.3,
        maximum=50,
        unit="mm",
        source=_NEUTRAL,
        description="outline corner radius",
    )
    thickness_mm: float = parameter(
        4.0, minimum=0.5, maximum=40, unit="mm", source=_NEUTRAL,
        description="height of the apex above the glued back",
    )  # fmt: skip
    crown_radius_x_mm: float = parameter(
        0.0, minimum=5, maximum=1e5, unit="mm", source=_NEUTRAL, zero_means="flat",
        description="radius of curvature of the contact face along x at the apex",
    )  # fmt: skip
    crown_radius_y_mm: float = parameter(
        0.0, minimum=5, maximum=1e5, unit="mm", source=_NEUTRAL, zero_means="flat",
        description="radius of curvature of the contact face along y at the apex",
    )  # fmt: skip
    rim: str = parameter(
        "none", choices=("none", "chamfer", "fillet"), source=_NEUTRAL,
        description="treatment of the edge between the contact face and the wall",
    )  # fmt: skip
    rim_mm: float = parameter(
        0.5, minimum=0.05, maximum=10, unit="mm", source=_NEUTRAL,
        description="leg of the chamfer or radius of the fillet, without effect when rim is none",
    )  # fmt: skip
    window_x_mm: float = parameter(
        18.0, minimum=1, maximum=100, unit="mm", source=_NEUTRAL,
        description="window (the part of the back that the camera sees) along x",
    )  # fmt: skip
    window_y_mm: float = parameter(
        14.0, minimum=1, maximum=100, unit="mm", source=_NEUTRAL, description="window along y"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        half = min(self.length_x_mm, self.length_y_mm) / 2
        if self.corner_radius_mm > half - 0.05:
            raise InputError(
                f"corner_radius_mm = {self.corner_radius_mm:g} does not fit the outline "
                f"{self.length_x_mm:g} x {self.length_y_mm:g} mm; allowed: up to {half - 0.05:g} mm"
            )
        if self.rim != "none" and self.rim_mm > 0.9 * self.corner_radius_mm:
            raise InputError(
                f"rim_mm = {self.rim_mm:g} cannot be built with corner_radius_mm = "
                f"{self.corner_radius_mm:g}; allowed: up to {0.9 * self.corner_radius_mm:g} mm"
            )
        self._check_crown()
        wall = self.min_wall_mm()
        if wall < MIN_WALL_MM:
            raise InputError(
                f"the crown and rim drop {self.thickness_mm - wall:.3f} mm at the lowest point of "
                f"the edge and leave {wall:.3f} mm of wall; thickness_mm must be at least "
                f"{self.thickness_mm - wall + MIN_WALL_MM:.3f} mm, or the crown radii larger"
            )
        self._check_window()

    def _check_crown(self) -> None:
        # Inside this bound the top stays less than 53 degrees steep, so that it is a height map.
        x, y = self.length_x_mm / 2, self.length_y_mm / 2
        cx, cy = self._curvatures()
        steep = float(np.hypot(x * cx, y * cy))
        if steep > 0.8:
            raise InputError(
                f"crown radii {self.crown_radius_x_mm:g} / {self.crown_radius_y_mm:g} mm are too "
                f"small for a pad of {self.length_x_mm:g} x {self.length_y_mm:g} mm: "
                f"hypot(x/Rx, y/Ry) at the corner is {steep:.3f}, allowed: up to 0.8"
            )

    def _check_window(self) -> None:
        corner = np.array([[self.window_x_mm / 2, self.window_y_mm / 2]])
        margin = float(self.inside_distance_mm(corner)[0])
        if margin < MIN_WINDOW_MARGIN_MM:
            raise InputError(
                f"window_x_mm x window_y_mm = {self.window_x_mm:g} x {self.window_y_mm:g} mm comes "
                f"within {margin:.3f} mm of the outline {self.length_x_mm:g} x "
                f"{self.length_y_mm:g} mm; allowed: at least {MIN_WINDOW_MARGIN_MM} mm away"
            )

    @property
    def is_flat(self) -> bool:
        return self.crown_radius_x_mm == 0 and self.crown_radius_y_mm == 0

    @property
    def is_spherical(self) -> bool:
        return self.crown_radius_x_mm == self.crown_radius_y_mm and not self.is_flat

    def _curvatures(self) -> tuple[float, float]:
        rx, ry = self.crown_radius_x_mm, self.crown_radius_y_mm
        return (1 / rx if rx else 0.0), (1 / ry if ry else 0.0)

    def inside_distance_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        """Distance to the outline [mm], positive inside, shape [...]; xy [mm], shape [..., 2]."""
        r = self.corner_radius_mm
        core = np.array([self.length_x_mm / 2 - r, self.length_y_mm / 2 - r])
        q = np.abs(np.asarray(xy_mm, dtype=np.float64)) - core
        outside = np.linalg.norm(np.maximum(q, 0), axis=-1)
        return r - outside - np.minimum(q.max(axis=-1), 0)

    def outward_normal(self, xy_mm: np.ndarray) -> np.ndarray:
        """Unit outward normal of the outline at the nearest outline point, shape [..., 2]."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        r = self.corner_radius_mm
        q = np.abs(xy) - np.array([self.length_x_mm / 2 - r, self.length_y_mm / 2 - r])
        on_arc = q.min(axis=-1, keepdims=True) > 0
        along_x = q[..., 0] >= q[..., 1]
        straight = np.stack([along_x, ~along_x], axis=-1).astype(np.float64)
        beyond = np.maximum(q, 0)
        length = np.linalg.norm(beyond, axis=-1, keepdims=True)
        arc = beyond / np.maximum(length, 1e-300)
        return np.where(on_arc, arc, straight) * np.where(xy < 0, -1.0, 1.0)

    def crown_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        """Height of the crown without its rim [mm], 0 at the apex, shape [...]."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        cx, cy = self._curvatures()
        x2, y2 = xy[..., 0] ** 2, xy[..., 1] ** 2
        root = np.sqrt(np.maximum(1 - cx**2 * x2 - cy**2 * y2, 0))
        return -(cx * x2 + cy * y2) / (1 + root)

    def crown_slope(self, xy_mm: np.ndarray) -> np.ndarray:
        """Gradient of the crown (dh/dx, dh/dy), shape [..., 2]."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        c = np.array(self._curvatures())
        root = np.sqrt(np.maximum(1 - (c**2 * xy**2).sum(axis=-1), 1e-12))[..., None]
        sag = (c * xy**2).sum(axis=-1)[..., None]
        return -(2 * c * xy * (1 + root) + sag * c**2 * xy / root) / (1 + root) ** 2

    def height_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        """Height of the contact face with its rim [mm] (z in the gel frame), shape [...]."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        height = self.crown_mm(xy)
        if self.rim == "none":
            return height
        distance = np.maximum(self.inside_distance_mm(xy), 0)
        if self.rim == "chamfer":
            return height - np.maximum(self.rim_mm - distance, 0)
        r = self.rim_mm
        # Slope of the crown towards the inside: the fillet touches the plane of that slope.
        slope = -(self.crown_slope(xy) * self.outward_normal(xy)).sum(axis=-1)
        root = np.sqrt(1 + slope**2)
        arc = slope * (r - distance) - r * root + np.sqrt(np.maximum(r**2 - (distance - r) ** 2, 0))
        return np.where(distance < r - r * slope / root, height + arc, height)

    def rim_setback_mm(self) -> float:
        """Greatest width of the rim band in plan [mm]; 0 without a rim."""
        return 0.0 if self.rim == "none" else self.rim_mm

    def outline_mm(self, points_per_arc: int = 16) -> np.ndarray:
        """Points on the outline, counter-clockwise [mm], shape [4 points_per_arc, 2]."""
        angle = np.linspace(0, np.pi / 2, points_per_arc)
        r = self.corner_radius_mm
        arcs = []
        for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            center = np.array([sx * (self.length_x_mm / 2 - r), sy * (self.length_y_mm / 2 - r)])
            a = angle + k * np.pi / 2
            arcs.append(center + r * np.stack([np.cos(a), np.sin(a)], axis=-1))
        return np.concatenate(arcs)

    def min_wall_mm(self) -> float:
        """Least height of the wall above the glued back [mm]."""
        return float(self.thickness_mm + self.height_mm(self.outline_mm(64)).min())

    def bounds_mm(self) -> np.ndarray:
        """Lowest and highest corner of the bounding box [mm], shape [2, 3]."""
        x, y = self.length_x_mm / 2, self.length_y_mm / 2
        return np.array([[-x, -y, -self.thickness_mm], [x, y, 0.0]])

    def top_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        """z of the contact face over gel xy [mm], NaN beside the pad; [..., 2] -> [...]."""
        inside = self.inside_distance_mm(xy_mm) >= 0
        return np.where(inside, self.height_mm(xy_mm), np.nan)

    def top_normal(self, xy_mm: np.ndarray) -> np.ndarray:
        """Outward unit normal of the contact face, NaN beside the pad; [..., 2] -> [..., 3]."""
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
        """Points moved to the plane z = -thickness [mm], [n, 3] -> [n, 3]."""
        moved = np.array(points_mm, dtype=np.float64)
        moved[:, 2] = -self.thickness_mm
        return moved

    def labelled_solid(self) -> LabelledSolid:
        """The body as a CAD solid with labelled faces; see ``gel_pad_solid``."""
        from cad.parts.gel_pad_solid import gel_pad_solid

        return gel_pad_solid(self)

    def figures(self) -> dict[str, float]:
        """What a drawing states beside the parameters [mm]."""
        corner = np.array([[self.window_x_mm / 2, self.window_y_mm / 2]])
        return {
            "wall_height_min": self.min_wall_mm(),
            "crown_drop_at_window_corner": -float(self.crown_mm(corner)[0]),
        }
