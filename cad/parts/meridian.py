# SPDX-License-Identifier: Apache-2.0
"""The profile of a body of revolution: lines and arcs in the half plane (r, z), labelled.

One profile gives the solid, its volume, its areas and the closest points on its surface, so that
each shape stands once. Angles of arcs are measured from +z towards +r, so that a dome begins at 0.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import Region

# Exact for lines; for the arcs of a dome the error is far below rounding.
_GAUSS = np.polynomial.legendre.leggauss(24)


class Piece(ABC):
    """A curve from fraction 0 to 1 whose points are (r, z) [mm]."""

    region: Region

    @abstractmethod
    def point(self, fraction: np.ndarray) -> np.ndarray:
        """(r, z) at fractions of the length [mm], [...] -> [..., 2]."""

    @abstractmethod
    def slope(self, fraction: np.ndarray) -> np.ndarray:
        """Derivative of ``point`` by the fraction [mm], [...] -> [..., 2]."""

    @abstractmethod
    def closest(self, rz_mm: np.ndarray) -> np.ndarray:
        """Closest (r, z) on the curve [mm], [n, 2] -> [n, 2]."""

    @property
    @abstractmethod
    def length_mm(self) -> float: ...

    def area_mm2(self) -> float:
        """Area that the curve sweeps when turned round the axis: integral of 2 pi r ds."""
        at, weight = 0.5 + 0.5 * _GAUSS[0], 0.5 * _GAUSS[1]
        return float(2 * np.pi * self.length_mm * (weight * self.point(at)[:, 0]).sum())

    def volume_mm3(self) -> float:
        """Volume between curve and axis, signed: integral of pi r^2 dz, negative going down."""
        at, weight = 0.5 + 0.5 * _GAUSS[0], 0.5 * _GAUSS[1]
        return float(np.pi * (weight * self.point(at)[:, 0] ** 2 * self.slope(at)[:, 1]).sum())


@dataclass(frozen=True)
class Line(Piece):
    """A straight piece: a disc, an annulus, a cylinder or a cone."""

    start: tuple[float, float]
    end: tuple[float, float]
    region: Region

    @property
    def length_mm(self) -> float:
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))

    def point(self, fraction: np.ndarray) -> np.ndarray:
        start, end = np.array(self.start), np.array(self.end)
        f = np.asarray(fraction, dtype=np.float64)[..., None]
        # Exact at both ends, so that neighbouring pieces meet bitwise.
        return (1 - f) * start + f * end

    def slope(self, fraction: np.ndarray) -> np.ndarray:
        along = np.array(self.end) - np.array(self.start)
        return np.broadcast_to(along, (*np.shape(fraction), 2))

    def closest(self, rz_mm: np.ndarray) -> np.ndarray:
        start = np.array(self.start)
        along = np.array(self.end) - start
        f = np.clip((rz_mm - start) @ along / (along @ along), 0, 1)
        return self.point(f)


@dataclass(frozen=True)
class Arc(Piece):
    """A circular piece: part of a sphere when its centre lies on the axis, else of a torus."""

    center: tuple[float, float]
    radius_mm: float
    start_angle: float
    """Angle from +z towards +r [rad]."""
    end_angle: float
    region: Region

    @property
    def length_mm(self) -> float:
        return self.radius_mm * abs(self.end_angle - self.start_angle)

    def point(self, fraction: np.ndarray) -> np.ndarray:
        f = np.asarray(fraction, dtype=np.float64)
        angle = (1 - f) * self.start_angle + f * self.end_angle
        return self._at(angle)

    def slope(self, fraction: np.ndarray) -> np.ndarray:
        turn = self.end_angle - self.start_angle
        angle = self.start_angle + turn * np.asarray(fraction, dtype=np.float64)
        return self.radius_mm * turn * np.stack([np.cos(angle), -np.sin(angle)], axis=-1)

    def closest(self, rz_mm: np.ndarray) -> np.ndarray:
        arm = rz_mm - np.array(self.center)
        low, high = sorted((self.start_angle, self.end_angle))
        middle = 0.5 * (low + high)
        # Angle relative to the middle of the arc, so that the cut lies opposite to it.
        turn = np.arctan2(arm[:, 0], arm[:, 1]) - middle
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        half = 0.5 * (high - low)
        return self._at(middle + np.clip(turn, -half, half))

    def _at(self, angle: np.ndarray) -> np.ndarray:
        arm = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
        return np.array(self.center) + self.radius_mm * arm


@dataclass(frozen=True)
class Meridian:
    """Pieces from the apex along the outside, over the rim and back along the inside to the axis.

    Each piece begins where the one before it ends; the first and the last end on the axis, or the
    body has a flat disc there.
    """

    pieces: tuple[Piece, ...]

    def of(self, *regions: Region) -> tuple[Piece, ...]:
        """Pieces of the given regions."""
        return tuple(piece for piece in self.pieces if piece.region in regions)

    def volume_mm3(self) -> float:
        """Volume of the body of revolution [mm^3]."""
        return abs(sum(piece.volume_mm3() for piece in self.pieces))

    def area_mm2(self, *regions: Region) -> float:
        """Area of the surfaces of the given regions [mm^2]."""
        return sum(piece.area_mm2() for piece in self.of(*regions))

    def gap_mm(self) -> float:
        """Greatest distance between the end of a piece and the start of the next [mm]."""
        ends = [piece.point(np.ones(())) for piece in self.pieces]
        starts = [piece.point(np.zeros(())) for piece in self.pieces[1:]]
        return max(float(np.linalg.norm(a - b)) for a, b in zip(ends, starts, strict=False))


def closest_on_pieces(
    pieces: tuple[Piece, ...], points_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Closest points on the surfaces of revolution of ``pieces`` and which piece holds each.

    points [mm], shape [n, 3]. Returns points [mm], shape [n, 3], and piece indices, shape [n].
    """
    points = np.asarray(points_mm, dtype=np.float64)
    radius = np.hypot(points[:, 0], points[:, 1])
    rz = np.stack([radius, points[:, 2]], axis=1)
    candidates = np.stack([piece.closest(rz) for piece in pieces])
    nearest = np.linalg.norm(candidates - rz, axis=-1).argmin(axis=0)
    found = candidates[nearest, np.arange(len(rz))]
    # On the axis every direction is as good; below the normal numbers quotients have no digits.
    beside = radius > np.finfo(np.float64).tiny
    safe = np.where(beside, radius, 1.0)
    direction = np.where(beside, points[:, :2].T / safe, np.array([[1.0], [0.0]]))
    return np.concatenate([(direction * found[:, 0]).T, found[:, 1:]], axis=1), nearest
