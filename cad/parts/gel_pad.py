# SPDX-License-Identifier: Apache-2.0
"""A gel pad as formulas: rounded-rectangle outline, crowned top, rim, glued flat back.

The gel frame in millimetres: origin at the apex of the contact face, z out of the gel, the glued
back at z = -thickness. Solid, meshes and tests all read their shape from here.

The crown is the biconic sag ``(x^2/Rx + y^2/Ry) / (1 + sqrt(1 - x^2/Rx^2 - y^2/Ry^2))``, which is
an exact sphere when Rx = Ry (ISO 10110-12 with zero conic constants), plus ``pillow sx sy / s``
with sx = x^2/2Rx, sy = y^2/2Ry and s their mean where the rim begins: with pillow = 1 the edge of
a crown with sx = sy there is level, as where a cast gel springs from a level frame.

A rim is a chamfer, a rolled fillet or an arc: a circular arc that rises from a wall of given height
and meets the crown's edge level, scaled to the height of that edge. With ``wall_mm`` a chamfer of a
flat pad may have any slope; one as wide as the corner radius or wider is cut by four planes, so
that the wall is a little higher in the corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taccel_lab.cad.parameters import parameter
from taccel_lab.cad.parts.height_pad import MIN_WALL_MM, HeightPad
from taccel_lab.cad.parts.pad_outline import PadOutline, rounded_rectangle
from taccel_lab.errors import InputError

_NEUTRAL = "neutral value; a sensor family sets its own"
_MAX_RIM_PER_CORNER = 0.9
"""Widest rim that rolls around a corner, in units of the corner radius."""
_MIN_RISE_MM = 0.05


@dataclass(frozen=True)
class GelPad(HeightPad):
    """Dimensions of one gel pad [mm]."""

    length_x_mm: float = parameter(
        24.0,
        minimum=4,
        maximum=100,
        unit="mm",
        source=_NEUTRAL,
        description="gel size along x (image columns)",
    )
    length_y_mm: float = parameter(
        20.0,
        minimum=4,
        maximum=100,
        unit="mm",
        source=_NEUTRAL,
        description="gel size along y (image rows)",
    )
    corner_radius_mm: float = parameter(
        2.0,
        minimum=0.3,
        maximum=50,
        unit="mm",
        source=_NEUTRAL,
        description="corner radius of the gel's outline",
    )
    thickness_mm: float = parameter(
        4.0, minimum=0.5, maximum=40, unit="mm", source=_NEUTRAL,
        description="gel thickness at the apex, from the glued back",
    )  # fmt: skip
    crown_radius_x_mm: float = parameter(
        0.0, minimum=5, maximum=1e5, unit="mm", source=_NEUTRAL, zero_means="flat",
        description="radius of curvature of the contact face along x at the apex",
    )  # fmt: skip
    crown_radius_y_mm: float = parameter(
        0.0, minimum=5, maximum=1e5, unit="mm", source=_NEUTRAL, zero_means="flat",
        description="radius of curvature of the contact face along y at the apex",
    )  # fmt: skip
    crown_pillow: float = parameter(
        0.0, minimum=0, maximum=1, source=_NEUTRAL,
        description="how far the crown's edge is level all around: 0 each point drops by both "
        "curvatures, 1 level where both drop the same",
    )  # fmt: skip
    rim: str = parameter(
        "none", choices=("none", "chamfer", "fillet", "arc"), source=_NEUTRAL,
        description="treatment of the edge between the contact face and the wall",
    )  # fmt: skip
    rim_mm: float = parameter(
        0.5, minimum=0.05, maximum=10, unit="mm", source=_NEUTRAL,
        description="leg of the chamfer, radius of the fillet or width of the arc in plan, without "
        "effect when rim is none",
    )  # fmt: skip
    wall_mm: float = parameter(
        0.0, minimum=MIN_WALL_MM, maximum=40, unit="mm", source=_NEUTRAL,
        zero_means="as the rim leaves it",
        description="height of the wall at which a chamfer or arc begins",
    )  # fmt: skip
    rim_radius_mm: float = parameter(
        5.0, minimum=0.06, maximum=1000, unit="mm", source=_NEUTRAL,
        description="radius of the arc, level where it meets the crown; for rim arc only",
    )  # fmt: skip
    bond_sides: str = parameter(
        "no", choices=("no", "yes"), source=_NEUTRAL,
        description="whether the wall is glued to the housing, too",
    )  # fmt: skip
    skin_top_mm: float = parameter(
        0.0, minimum=0.05, maximum=5, unit="mm", source=_NEUTRAL, zero_means="no skin",
        description="thickness along z of a skin of another material on the contact face",
    )  # fmt: skip
    skin_side_mm: float = parameter(
        0.0, minimum=0.1, maximum=5, unit="mm", source=_NEUTRAL, zero_means="no skin there",
        description="thickness of the skin on the wall",
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
        outline = f"the outline {self.length_x_mm:g} x {self.length_y_mm:g} mm"
        self.require("corner_radius_mm", f"does not fit {outline}", high=half - 0.05)
        self._check_crown()
        self._check_rim(half, outline)
        self._check_wall()
        self._check_skin()
        self._check_window()

    def _check_rim(self, half_mm: float, outline: str) -> None:
        rolls = self.rim == "fillet" or (self.rim == "chamfer" and not self.wall_mm)
        if rolls:
            corner = f"corner_radius_mm = {self.corner_radius_mm:g}"
            self.require("rim_mm", f"cannot be built with {corner}", high=self._most_rolled_mm)
        if self.rim not in ("chamfer", "arc") or rolls:
            return
        self.require("rim_mm", f"is too wide for {outline}", high=0.8 * half_mm)
        if self.rim == "chamfer" and not self.is_flat:
            raise InputError(
                f"wall_mm = {self.wall_mm:g} with rim chamfer needs a flat contact face; allowed: "
                "0, or rim arc, or crown radii 0"
            )
        if self.rim == "arc":
            small = f"is too small for a rim_mm of {self.rim_mm:g}"
            self.require("rim_radius_mm", small, low=1.05 * self.rim_mm)
        edge = self.outline.points_mm(64)
        highest = self.thickness_mm + float(
            self.crown_mm(self._band.fraction_and_foot(edge)[1]).min()
        )
        if not MIN_WALL_MM <= self.wall_mm <= highest - _MIN_RISE_MM:
            raise InputError(
                f"wall_mm = {self.wall_mm:g} with rim {self.rim}: the crown's edge lies at "
                f"{highest:.3f} mm over the back; allowed: {MIN_WALL_MM:g} to "
                f"{highest - _MIN_RISE_MM:.3f} mm"
            )

    @property
    def _most_rolled_mm(self) -> float:
        """Widest rim, or skin on the wall, that rolls around a corner."""
        return _MAX_RIM_PER_CORNER * self.corner_radius_mm

    def _check_skin(self) -> None:
        if not self.skin_top_mm and not self.skin_side_mm:
            return
        if not self.skin_top_mm:
            raise InputError(
                f"skin_side_mm = {self.skin_side_mm:g} needs a skin on the contact face, too; set "
                "skin_top_mm, or skin_side_mm to 0"
            )
        if self.rim == "fillet":
            raise InputError("a skin cannot have rim fillet; allowed: rim none, chamfer or arc")
        corner = f"corner_radius_mm = {self.corner_radius_mm:g}"
        self.require("skin_side_mm", f"does not fit {corner}", high=self._most_rolled_mm)
        if self.skin_side_mm and self.rim != "none":
            self.require(
                "rim_mm", "is too wide for a skin on the wall", high=self._most_rolled_mm,
                also=", or skin_side_mm = 0",
            )  # fmt: skip
        core = self.outline.inset(self.skin_side_mm).points_mm(64)
        gel = self.thickness_mm + float(self.height_mm(core).min()) - self.skin_top_mm
        left = f"leaves {gel:.3f} mm of gel under the skin's edge"
        self.require("skin_top_mm", left, high=self.skin_top_mm + gel - MIN_WALL_MM)

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

    @property
    def is_flat(self) -> bool:
        return self.crown_radius_x_mm == 0 and self.crown_radius_y_mm == 0

    @property
    def is_spherical(self) -> bool:
        return self.crown_radius_x_mm == self.crown_radius_y_mm and not self.is_flat

    def _curvatures(self) -> tuple[float, float]:
        rx, ry = self.crown_radius_x_mm, self.crown_radius_y_mm
        return (1 / rx if rx else 0.0), (1 / ry if ry else 0.0)

    @cached_property
    def outline(self) -> PadOutline:
        return rounded_rectangle(self.length_x_mm, self.length_y_mm, self.corner_radius_mm)

    @property
    def has_fillet(self) -> bool:
        return self.rim == "fillet"

    @property
    def has_band(self) -> bool:
        """True when the rim rises from a wall of given height to the crown's edge."""
        return self.rim == "arc" or (self.rim == "chamfer" and self.wall_mm > 0)

    @property
    def sides_bonded(self) -> bool:
        return self.bond_sides == "yes"

    @cached_property
    def _band(self) -> RimBand:
        half_x, half_y = self.length_x_mm / 2, self.length_y_mm / 2
        # A bevel wider than the corner radius is cut by four planes, as if corners were sharp.
        planes = self.rim == "chamfer" and self.rim_mm >= self.corner_radius_mm
        return RimBand(half_x, half_y, 0.0 if planes else self.corner_radius_mm, self.rim_mm)

    @cached_property
    def _pillow_per_mm(self) -> float:
        """Factor of sx sy in the crown [1/mm]."""
        cx, cy = self._curvatures()
        inset = self.rim_mm if self.has_band else 0.0
        x, y = self.length_x_mm / 2 - inset, self.length_y_mm / 2 - inset
        edge = (cx * x**2 + cy * y**2) / 4
        return self.crown_pillow / edge if edge else 0.0

    def crown_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        xy = np.asarray(xy_mm, dtype=np.float64)
        cx, cy = self._curvatures()
        x2, y2 = xy[..., 0] ** 2, xy[..., 1] ** 2
        root = np.sqrt(np.maximum(1 - cx**2 * x2 - cy**2 * y2, 0))
        level = self._pillow_per_mm * cx * cy * x2 * y2 / 4
        return level - (cx * x2 + cy * y2) / (1 + root)

    def crown_slope(self, xy_mm: np.ndarray) -> np.ndarray:
        xy = np.asarray(xy_mm, dtype=np.float64)
        c = np.array(self._curvatures())
        root = np.sqrt(np.maximum(1 - (c**2 * xy**2).sum(axis=-1), 1e-12))[..., None]
        sag = (c * xy**2).sum(axis=-1)[..., None]
        level = 0.5 * self._pillow_per_mm * c[0] * c[1] * xy * xy[..., ::-1] ** 2
        return level - (2 * c * xy * (1 + root) + sag * c**2 * xy / root) / (1 + root) ** 2

    def height_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        xy = np.asarray(xy_mm, dtype=np.float64)
        if self.has_band:
            fraction, foot = self._band.fraction_and_foot(xy)
            wall = self.wall_mm - self.thickness_mm
            return wall + (self.crown_mm(foot) - wall) * self._rise(fraction)
        if self.rim == "chamfer":
            return self._chamfered_mm(xy)
        return super().height_mm(xy)

    def _chamfered_mm(self, xy: np.ndarray) -> np.ndarray:
        """Straight from ``rim_mm`` down the wall to ``rim_mm`` along the crown's slope."""
        distance = np.maximum(self.inside_distance_mm(xy), 0)
        normal = self.outline.outward_normal(xy)
        edge = xy + distance[..., None] * normal
        slope = (self.crown_slope(edge) * normal).sum(axis=-1)
        width = self.rim_mm / np.sqrt(1 + slope**2)
        low = self.crown_mm(edge) - self.rim_mm
        high = self.crown_mm(edge - width[..., None] * normal)
        bevel = low + (high - low) * distance / width
        return np.where(distance < width, bevel, self.crown_mm(xy))

    def _rise(self, fraction: np.ndarray) -> np.ndarray:
        """Height of the band over the wall in units of the crown's edge: 1 at 0, 0 at 1."""
        if self.rim == "chamfer":
            return 1 - fraction
        ratio = (self.rim_mm / self.rim_radius_mm) ** 2
        low = np.sqrt(1 - ratio)
        inside = np.minimum(fraction, 1)
        arc = (np.sqrt(1 - ratio * inside**2) - low) / (1 - low)
        # Beyond the wall on along the tangent: solids are cut from a top larger than the pad.
        return arc - ratio / low / (1 - low) * (fraction - inside)

    def rim_setback_mm(self) -> float:
        return 0.0 if self.rim == "none" else self.rim_mm


@dataclass(frozen=True)
class RimBand:
    """A rim along the edge of a rounded rectangle [mm], as wide as the corner radius or wider.

    It leads along straight rays from the inner outline, inset by the band's width, to the wall.
    Where the band is wider than the corner radius the inner outline has sharp corners and the rays
    fan out from them, so that the rim stays smooth across the diagonals, as a cast gel is.
    """

    half_x_mm: float
    half_y_mm: float
    corner_radius_mm: float
    width_mm: float

    def fraction_and_foot(self, xy_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where points lie in the band: 0 on and inside the inner outline, 1 on the wall, [...].

        Also their foot [mm]: the begin of their ray on the inner outline, or the point itself when
        it lies inside; [..., 2].
        """
        xy = np.asarray(xy_mm, dtype=np.float64)
        r, b = self.corner_radius_mm, self.width_mm
        reach = max(r, b)
        core = np.array([self.half_x_mm - reach, self.half_y_mm - reach])
        q = np.abs(xy) - core
        length = np.linalg.norm(np.maximum(q, 0), axis=-1)
        in_corner = q.min(axis=-1) > 0
        unit = np.maximum(q, 0) / np.maximum(length, 1e-300)[..., None]
        wall = np.where(in_corner, self._to_wall_mm(unit, reach), reach)
        inner = max(r - b, 0.0)
        fraction = np.maximum(length - inner, 0) / (wall - inner)
        foot = np.minimum(q, 0) + np.minimum(length, inner)[..., None] * unit
        return fraction, (core + foot) * np.where(xy < 0, -1.0, 1.0)

    def _to_wall_mm(self, unit: np.ndarray, reach: float) -> np.ndarray:
        """Distance from the core's corner to the wall in the direction ``unit`` [..., 2]."""
        r = self.corner_radius_mm
        center = reach - r
        # Straight walls first: each ray meets the nearer of both lines, or the arc between them.
        line = reach / np.maximum(unit.max(axis=-1), 1e-300)
        other = line * unit.min(axis=-1)
        along = center * unit.sum(axis=-1)
        arc = along + np.sqrt(np.maximum(along**2 - 2 * center**2 + r**2, 0))
        return np.where(other <= center, line, arc)
