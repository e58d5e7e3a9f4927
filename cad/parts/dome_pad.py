# SPDX-License-Identifier: Apache-2.0
"""Axisymmetric gel pads as formulas: the solid dome on a cylinder and the soft shell on a core.

Both are bodies of revolution about z with a spherical contact face. Their meridian, a chain of
lines and arcs, gives surfaces, solid, volume and closest points.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taccel_lab.cad.parameters import parameter
from taccel_lab.cad.parts.meridian import Arc, Line, Meridian, Piece, closest_on_pieces
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

_NEUTRAL = "neutral value; a sensor family sets its own"
MIN_GEL_MM = 0.3
"""Least thickness of gel anywhere [mm]: thinner gel tears and meshes badly."""


class DomePad(Pad):
    """A body of revolution about z whose contact face is a spherical cap, apex at the origin."""

    dome_radius_mm: float

    @property
    @abstractmethod
    def cap_angle(self) -> float:
        """Half angle of the contact face seen from the sphere's centre [rad]."""

    @cached_property
    @abstractmethod
    def meridian(self) -> Meridian:
        """Profile from the apex along the outside, over the rim and back along the inside."""

    @property
    def cap_radius_mm(self) -> float:
        """Radius of the contact face in plan [mm]."""
        return self.dome_radius_mm * math.sin(self.cap_angle)

    def bounds_mm(self) -> np.ndarray:
        f = np.linspace(0, 1, 65)
        ends = np.concatenate([piece.point(f) for piece in self.meridian.pieces])
        r, low = self.cap_radius_mm, float(ends[:, 1].min())
        return np.array([[-r, -r, low], [r, r, 0.0]])

    def top_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        r2 = (np.asarray(xy_mm, dtype=np.float64) ** 2).sum(axis=-1)
        big = self.dome_radius_mm
        root = np.sqrt(np.maximum(big**2 - r2, 0))
        # Sag without cancellation at the apex.
        return np.where(r2 <= self.cap_radius_mm**2, -r2 / (big + root), np.nan)

    def top_normal(self, xy_mm: np.ndarray) -> np.ndarray:
        xy = np.asarray(xy_mm, dtype=np.float64)
        height = self.top_mm(xy)[..., None] + self.dome_radius_mm
        normal = np.concatenate([np.where(np.isnan(height), np.nan, xy), height], axis=-1)
        return normal / self.dome_radius_mm

    def inside_distance_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        return self.cap_radius_mm - np.linalg.norm(np.asarray(xy_mm, dtype=np.float64), axis=-1)

    def arc_to_edge_mm(self, xy_mm: np.ndarray) -> float:
        """Length along the cap from its point over gel xy, [2], to its edge [mm]."""
        away = min(float(np.hypot(*xy_mm)) / self.dome_radius_mm, 1.0)
        return self.dome_radius_mm * (self.cap_angle - math.asin(away))

    def contact_error_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """Distance of points from the contact face's sphere [mm], [n, 3] -> [n]."""
        center = np.array([0, 0, -self.dome_radius_mm])
        return np.abs(np.linalg.norm(points_mm - center, axis=1) - self.dome_radius_mm)

    def bond_projection_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """Closest points on the glued surface of revolution [mm], [n, 3] -> [n, 3]."""
        glued = self.meridian.of(Region.BOND, Region.WINDOW)
        return closest_on_pieces(glued, points_mm)[0]

    def region_of(self, points_mm: np.ndarray) -> np.ndarray:
        """``Region`` of the surface closest to each point, int32, [n, 3] -> [n]."""
        pieces = self.meridian.pieces
        nearest = closest_on_pieces(pieces, points_mm)[1]
        return np.array([int(piece.region) for piece in pieces], dtype=np.int32)[nearest]

    def figures(self) -> dict[str, float]:
        low, high = self.bounds_mm()
        return {
            "total_height": float(high[2] - low[2]),
            "base_diameter": float(high[0] - low[0]),
            "gel_under_apex": self.thickness_mm,
            "volume_mm3": self.volume_mm3(),
            "contact_area_mm2": self.meridian.area_mm2(Region.CONTACT),
        }

    def volume_mm3(self) -> float:
        return self.meridian.volume_mm3()


@dataclass(frozen=True)
class SolidDomePad(DomePad):
    """A full hemisphere on a cylinder with a pocket in its base, into which the lens is glued.

    Contact is the hemisphere, window the pocket, bond the flat base and ``bonded_wall_mm`` of the
    cylinder above it; the rest of the cylinder is side.
    """

    dome_radius_mm: float = parameter(
        12.5, minimum=4, maximum=60, unit="mm", source=_NEUTRAL,
        description="radius of the hemisphere and of the cylinder under it",
    )  # fmt: skip
    wall_height_mm: float = parameter(
        13.5, minimum=1, maximum=100, unit="mm", source=_NEUTRAL,
        description="height of the cylinder between the hemisphere and the glued base",
    )  # fmt: skip
    bonded_wall_mm: float = parameter(
        0.0, minimum=0.5, maximum=100, unit="mm", source=_NEUTRAL, zero_means="free wall",
        description="height of the wall above the base that is glued to the housing",
    )  # fmt: skip
    pocket_radius_mm: float = parameter(
        4.9, minimum=1, maximum=50, unit="mm", source=_NEUTRAL,
        description="radius of the lens pocket at the base",
    )  # fmt: skip
    pocket_taper_deg: float = parameter(
        2.0, minimum=0, maximum=30, unit="deg", source=_NEUTRAL,
        description="angle by which the pocket's wall leans inward",
    )  # fmt: skip
    pocket_depth_mm: float = parameter(
        1.5, minimum=0.5, maximum=50, unit="mm", source=_NEUTRAL,
        description="depth of the edge of the pocket's ceiling below the base plane",
    )  # fmt: skip
    pocket_edge_radius_mm: float = parameter(
        0.25, minimum=0.05, maximum=5, unit="mm", source=_NEUTRAL,
        description="fillet between the pocket's wall and its ceiling",
    )  # fmt: skip
    pocket_dome_radius_mm: float = parameter(
        7.5, minimum=2, maximum=500, unit="mm", source=_NEUTRAL,
        description="radius of the pocket's ceiling, a dome that rises into the gel",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        free = f"leaves less than 0.5 mm of the wall of {self.wall_height_mm:g} mm free"
        self.require("bonded_wall_mm", free, high=self.wall_height_mm - 0.5)
        needed = max(1.0, 0.1 * self.dome_radius_mm)
        narrow = f"leaves too narrow a base in a dome of radius {self.dome_radius_mm:g} mm"
        self.require("pocket_radius_mm", narrow, high=self.dome_radius_mm - needed)
        edge = self._pocket_edge
        if self.thickness_mm < needed:
            raise InputError(
                f"the pocket reaches {edge.apex_depth_mm:.3f} mm above the base and leaves "
                f"{self.thickness_mm:.3f} mm of gel under the apex; allowed: at least {needed:g} mm"
            )
        # Beside the axis the ceiling stays below the dome if it does so at its edge.
        corner = np.hypot(edge.joint_r, max(edge.joint_depth - self.wall_height_mm, 0))
        if self.dome_radius_mm - corner < needed:
            raise InputError(
                f"the edge of the pocket's ceiling comes within {self.dome_radius_mm - corner:.3f} "
                f"mm of the contact face; allowed: at least {needed:g} mm"
            )

    @property
    def total_height_mm(self) -> float:
        """Height from the base to the apex [mm]."""
        return self.dome_radius_mm + self.wall_height_mm

    @property
    def cap_angle(self) -> float:
        return math.pi / 2

    @property
    def thickness_mm(self) -> float:  # type: ignore[override]
        """Gel between the apex and the top of the pocket [mm]."""
        return self.total_height_mm - self._pocket_edge.apex_depth_mm

    @cached_property
    def _pocket_edge(self) -> _PocketEdge:
        """Where a ball of the fillet's radius touches the pocket's wall, a cone, and, from inside,
        the ceiling's sphere.

        Its centre is ``inner`` from the sphere's centre. Raises InputError when no ball fits.
        """
        taper, fillet = math.radians(self.pocket_taper_deg), self.pocket_edge_radius_mm
        inner = self.pocket_dome_radius_mm - fillet
        foot = self.pocket_radius_mm - fillet * (1 / math.cos(taper))
        torus_depth, torus_r = self.pocket_depth_mm, 0.0
        for _ in range(20):  # a contraction by tan(taper) fillet / inner
            torus_r = foot - torus_depth * math.tan(taper)
            if inner <= 0 or not 0 < torus_r < inner:
                raise self._no_pocket()
            rise = math.sqrt(inner**2 - torus_r**2)
            torus_depth = self.pocket_depth_mm - rise * fillet / inner
        joint_angle = math.atan2(torus_r, math.sqrt(inner**2 - torus_r**2))
        wall = torus_depth + fillet * math.sin(taper)
        if joint_angle >= math.pi / 2 - taper or wall < 0.1:
            raise self._no_pocket()
        return _PocketEdge(
            torus_r=torus_r,
            torus_depth=torus_depth,
            joint_r=torus_r + fillet * math.sin(joint_angle),
            joint_depth=torus_depth + fillet * math.cos(joint_angle),
            joint_angle=joint_angle,
            wall_mm=wall,
            apex_depth_mm=torus_depth - inner * math.cos(joint_angle) + self.pocket_dome_radius_mm,
        )

    def _no_pocket(self) -> InputError:
        return InputError(
            f"a pocket of radius {self.pocket_radius_mm:g}, depth {self.pocket_depth_mm:g} and "
            f"edge fillet {self.pocket_edge_radius_mm:g} mm has no room for its wall under a "
            f"ceiling of radius {self.pocket_dome_radius_mm:g} mm; allowed: a deeper pocket, a "
            "smaller pocket_edge_radius_mm or pocket_taper_deg, or a pocket_dome_radius_mm "
            f"above {self.pocket_radius_mm:g} mm"
        )

    @cached_property
    def meridian(self) -> Meridian:
        edge = self._pocket_edge
        big, base = self.dome_radius_mm, -self.total_height_mm
        taper = math.radians(self.pocket_taper_deg)
        glue = base + self.bonded_wall_mm
        pieces: list[Piece] = [Arc((0, -big), big, 0, math.pi / 2, Region.CONTACT)]
        pieces.append(Line((big, -big), (big, glue), Region.SIDE))
        if self.bonded_wall_mm > 0:
            pieces.append(Line((big, glue), (big, base), Region.BOND))
        pocket = (self.pocket_radius_mm, base)
        pieces.append(Line((big, base), pocket, Region.BOND))
        fillet_center = (edge.torus_r, base + edge.torus_depth)
        fillet = self.pocket_edge_radius_mm
        # The cone touches the fillet where its normal, tilted by the taper, points outward.
        touch = math.pi / 2 - taper
        wall_end = (
            edge.torus_r + fillet * math.sin(touch),
            base + edge.torus_depth + fillet * math.cos(touch),
        )
        pieces.append(Line(pocket, wall_end, Region.WINDOW))
        pieces.append(Arc(fillet_center, fillet, touch, edge.joint_angle, Region.WINDOW))
        ceiling_center = (0.0, base + edge.apex_depth_mm - self.pocket_dome_radius_mm)
        pieces.append(
            Arc(ceiling_center, self.pocket_dome_radius_mm, edge.joint_angle, 0, Region.WINDOW)
        )
        return Meridian(tuple(pieces))

    def figures(self) -> dict[str, float]:
        edge = self._pocket_edge
        return {
            **super().figures(),
            "pocket_depth_at_axis": edge.apex_depth_mm,
            "pocket_wall_height": edge.wall_mm,
            "pocket_volume_mm3": sum(
                piece.volume_mm3() for piece in self.meridian.of(Region.WINDOW)
            ),
        }


@dataclass(frozen=True)
class _PocketEdge:
    """Where the fillet between the pocket's wall and ceiling lies; depths rise from the base."""

    torus_r: float
    torus_depth: float
    joint_r: float
    joint_depth: float
    joint_angle: float
    """Angle at which fillet and ceiling touch, from +z [rad]."""
    wall_mm: float
    """Height of the conical wall."""
    apex_depth_mm: float


@dataclass(frozen=True)
class ShellDomePad(DomePad):
    """A soft gel of even thickness over a hard domed core, with or without a cylindrical skirt.

    Contact is the outer cap, window the part of the inner cap that the camera sees, bond the rest
    of the inside and, unless it is free, the rim; the outside of the skirt is side.
    """

    dome_radius_mm: float = parameter(
        15.0, minimum=3, maximum=60, unit="mm", source=_NEUTRAL,
        description="outer radius of the gel",
    )  # fmt: skip
    thickness_mm: float = parameter(
        1.5, minimum=MIN_GEL_MM, maximum=20, unit="mm", source=_NEUTRAL,
        description="thickness of the gel over the core",
    )  # fmt: skip
    opening_deg: float = parameter(
        90.0, minimum=25, maximum=90, unit="deg", source=_NEUTRAL,
        description="half angle of the cap; 90 is a hemisphere",
    )  # fmt: skip
    skirt_mm: float = parameter(
        0.0, minimum=0.5, maximum=60, unit="mm", source=_NEUTRAL, zero_means="no cylindrical part",
        description="height of the cylinder below a hemisphere",
    )  # fmt: skip
    window_deg: float = parameter(
        0.0, minimum=15, maximum=89, unit="deg", source=_NEUTRAL, zero_means="the whole cap",
        description="half angle of the inner cap that the camera sees",
    )  # fmt: skip
    rim: str = parameter(
        "bonded", choices=("bonded", "free"), source=_NEUTRAL,
        description="whether the gel's flat rim is glued to the housing",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        core = f"leaves a core of radius {self.dome_radius_mm - self.thickness_mm:g} mm"
        self.require("thickness_mm", core, high=0.7 * self.dome_radius_mm)
        if self.skirt_mm and self.opening_deg < 90:
            raise InputError(
                f"skirt_mm = {self.skirt_mm:g} needs a hemisphere to continue; allowed with "
                f"opening_deg = {self.opening_deg:g}: 0 (no cylindrical part)"
            )
        cap = f"does not fit a cap of {self.opening_deg:g} deg"
        self.require("window_deg", cap, high=self.opening_deg - 1, also=", or 0 (the whole cap)")
        if self.rim == "free" and not (self.skirt_mm or self.window_deg):
            raise InputError(
                "with rim = 'free' and window_deg = 0 nothing but the window is glued; set "
                f"window_deg, up to {self.opening_deg - 1:g} deg"
            )

    @property
    def core_radius_mm(self) -> float:
        """Radius of the hard core [mm]."""
        return self.dome_radius_mm - self.thickness_mm

    @property
    def cap_angle(self) -> float:
        return math.radians(self.opening_deg)

    @property
    def window_angle(self) -> float:
        """Half angle of the window [rad]."""
        return math.radians(self.window_deg) if self.window_deg else self.cap_angle

    @cached_property
    def meridian(self) -> Meridian:
        big, small, angle = self.dome_radius_mm, self.core_radius_mm, self.cap_angle
        center = (0.0, -big)
        outer = Arc(center, big, 0, angle, Region.CONTACT)
        rim = Region.BOND if self.rim == "bonded" else Region.SIDE
        pieces: list[Piece] = [outer]
        if self.skirt_mm:
            low = -big - self.skirt_mm
            pieces.append(Line((big, -big), (big, low), Region.SIDE))
            pieces.append(Line((big, low), (small, low), rim))
            pieces.append(Line((small, low), (small, -big), Region.BOND))
        else:
            inner_end = Arc(center, small, 0, angle, Region.BOND).point(np.ones(()))
            outer_end = outer.point(np.ones(()))
            pieces.append(Line(_pair(outer_end), _pair(inner_end), rim))
        if self.window_deg:
            pieces.append(Arc(center, small, angle, self.window_angle, Region.BOND))
        pieces.append(Arc(center, small, self.window_angle, 0, Region.WINDOW))
        return Meridian(tuple(pieces))


def _pair(point: np.ndarray) -> tuple[float, float]:
    return float(point[0]), float(point[1])
