# SPDX-License-Identifier: Apache-2.0
"""Outline of a pad in plan: the tight band around circles, arcs joined by common tangents.

Four equal circles give a rounded rectangle, two small ones and a large one the D of a DIGIT. Such
an outline is convex and has a normal everywhere, so that the distance of an inside point is the
least of its distances from the sides' lines and from the arcs that it faces.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class PadOutline:
    """The convex hull of circles that all touch it, counter-clockwise from any one."""

    circles: tuple[tuple[float, float, float], ...]
    """x, y and radius of each circle [mm]."""

    @cached_property
    def centers_mm(self) -> np.ndarray:
        """Centres of the arcs, shape [n, 2]."""
        return np.array([c[:2] for c in self.circles])

    @cached_property
    def radii_mm(self) -> np.ndarray:
        """Radii of the arcs, shape [n]."""
        return np.array([c[2] for c in self.circles])

    @cached_property
    def side_normals(self) -> np.ndarray:
        """Outward normal of the side from arc i to arc i + 1, shape [n, 2]."""
        along = np.roll(self.centers_mm, -1, axis=0) - self.centers_mm
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along = along / length
        right = np.stack([along[:, 1], -along[:, 0]], axis=1)
        lean = (self.radii_mm - np.roll(self.radii_mm, -1))[:, None] / length
        normals = right * np.sqrt(1 - lean**2) + along * lean
        # Sides along an axis keep their coordinate to the last digit.
        return np.where(np.abs(normals) < 1e-12, 0.0, np.where(
            np.abs(normals) > 1 - 1e-12, np.sign(normals), normals))  # fmt: skip

    @cached_property
    def arc_angles(self) -> np.ndarray:
        """Direction of the normal at the begin and the end of each arc [rad], shape [n, 2]."""
        ends = np.arctan2(self.side_normals[:, 1], self.side_normals[:, 0])
        begins = np.roll(ends, 1)
        return np.stack([begins, begins + (ends - begins) % (2 * np.pi)], axis=1)

    @cached_property
    def side_ends_mm(self) -> np.ndarray:
        """First and last point of each side, shape [n, 2, 2]."""
        following = np.roll(self.centers_mm, -1, axis=0)
        n, r = self.side_normals, self.radii_mm[:, None]
        return np.stack([self.centers_mm + r * n, following + np.roll(r, -1, axis=0) * n], axis=1)

    @cached_property
    def piece_lengths_mm(self) -> np.ndarray:
        """Lengths of arc 0, side 0, arc 1, side 1, ...; shape [2 n]."""
        arcs = self.radii_mm * np.diff(self.arc_angles, axis=1)[:, 0]
        sides = np.linalg.norm(np.diff(self.side_ends_mm, axis=1)[:, 0], axis=1)
        return np.stack([arcs, sides], axis=1).ravel()

    @property
    def perimeter_mm(self) -> float:
        return float(self.piece_lengths_mm.sum())

    @cached_property
    def area_mm2(self) -> float:
        """Enclosed area by Green's theorem, exact."""
        first, last = self.side_ends_mm[:, 0], self.side_ends_mm[:, 1]
        turn = np.diff(self.arc_angles, axis=1)[:, 0]
        chord = first - np.roll(last, 1, axis=0)
        double = _cross(first, last) + self.radii_mm**2 * turn + _cross(self.centers_mm, chord)
        return float(double.sum() / 2)

    def bounds_mm(self) -> np.ndarray:
        """Lowest and highest corner of the bounding rectangle, shape [2, 2]."""
        r = self.radii_mm[:, None]
        return np.stack([(self.centers_mm - r).min(axis=0), (self.centers_mm + r).max(axis=0)])

    def inset(self, distance_mm: float) -> PadOutline:
        """The outline ``distance_mm`` further in; less than the smallest radius."""
        return PadOutline(tuple((x, y, r - distance_mm) for x, y, r in self.circles))

    def inside_distance_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        """Distance to the outline [mm], positive inside, shape [...]; xy [mm], shape [..., 2]."""
        return self.nearest(xy_mm)[0]

    def outward_normal(self, xy_mm: np.ndarray) -> np.ndarray:
        """Unit outward normal of the outline at the nearest outline point, shape [..., 2]."""
        return self.nearest(xy_mm)[1]

    def nearest(self, xy_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance to the outline [mm], positive inside, and its unit outward normal and curvature
        [1/mm] at the nearest outline point; shapes [...], [..., 2] and [...]."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        distance = np.full(xy.shape[:-1], np.inf)
        normal = np.zeros(xy.shape)
        curvature = np.zeros(xy.shape[:-1])
        for k, center in enumerate(self.centers_mm):
            from_center = xy - center
            side = self.side_normals[k]
            to_side = self.radii_mm[k] - from_center @ side
            nearer = to_side < distance
            distance = np.where(nearer, to_side, distance)
            normal = np.where(nearer[..., None], side, normal)
            curvature = np.where(nearer, 0.0, curvature)
        for k, center in enumerate(self.centers_mm):
            from_center = xy - center
            begin, end = np.roll(self.side_normals, 1, axis=0)[k], self.side_normals[k]
            wide = self.arc_angles[k, 1] - self.arc_angles[k, 0] >= np.pi - 1e-9
            after, before = _cross(begin, from_center), -_cross(end, from_center)
            # Half a turn has both ends on one line: which half tells the normal midway.
            middle = self.arc_angles[k].mean()
            towards = from_center @ np.array([np.cos(middle), np.sin(middle)])
            faces = towards > 0 if wide else (after > 0) & (before > 0)
            length = np.linalg.norm(from_center, axis=-1)
            to_arc = self.radii_mm[k] - length
            faces &= to_arc < distance + 1e-12
            distance = np.where(faces, to_arc, distance)
            outward = from_center / np.maximum(length, 1e-300)[..., None]
            normal = np.where(faces[..., None], outward, normal)
            curvature = np.where(faces, 1 / max(self.radii_mm[k], 1e-300), curvature)
        return distance, normal, curvature

    def at_mm(self, length_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points [mm] and outward normals at lengths along the outline from the begin of arc 0.

        Lengths of any shape [...], also negative or beyond one turn; both results [..., 2].
        """
        starts = np.concatenate([[0.0], np.cumsum(self.piece_lengths_mm)])
        s = np.asarray(length_mm, dtype=np.float64) % starts[-1]
        piece = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(starts) - 2)
        k, rest = piece // 2, s - starts[piece]
        angle = self.arc_angles[k, 0] + rest / self.radii_mm[k]
        on_arc = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        side = self.side_normals[k]
        ahead = np.stack([-side[..., 1], side[..., 0]], axis=-1)
        straight = (piece % 2 == 1)[..., None]
        normal = np.where(straight, side, on_arc)
        from_center = self.radii_mm[k][..., None] * normal
        offset = np.where(straight, from_center + rest[..., None] * ahead, from_center)
        return self.centers_mm[k] + offset, normal

    def points_mm(self, points_per_arc: int = 16) -> np.ndarray:
        """Points on the arcs, their ends included, counter-clockwise, shape [n points, 2]."""
        t = np.linspace(0, 1, points_per_arc)[:, None]
        angle = self.arc_angles[:, :1].T * (1 - t) + self.arc_angles[:, 1:].T * t
        unit = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        points = self.centers_mm + self.radii_mm[:, None] * unit
        return points.transpose(1, 0, 2).reshape(-1, 2)


def rounded_rectangle(length_x_mm: float, length_y_mm: float, radius_mm: float) -> PadOutline:
    """Rectangle about the origin with rounded corners; the first arc is that of +x and +y."""
    x, y = length_x_mm / 2 - radius_mm, length_y_mm / 2 - radius_mm
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    return PadOutline(tuple((sx * x, sy * y, radius_mm) for sx, sy in signs))


def d_shape(width_mm: float, length_mm: float, corner_radius_mm: float) -> PadOutline:
    """Half a circle at +y over the full width, straight sides, rounded corners at -y.

    The bounding rectangle is centred on the origin; the first arc is the half circle.
    """
    half, low = width_mm / 2, -length_mm / 2 + corner_radius_mm
    x = half - corner_radius_mm
    corners = ((-x, low, corner_radius_mm), (x, low, corner_radius_mm))
    return PadOutline(((0.0, length_mm / 2 - half, half), *corners))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
