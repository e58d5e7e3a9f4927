# SPDX-License-Identifier: Apache-2.0
"""The rim as a rolling ball leaves it: the ball touches the wall and lies under the crown.

A fillet is the upper envelope of all balls of its radius that fit below the crown and inside the
wall (J. Rossignac, A. Requicha, Computers in Mechanical Engineering 3 (1984) 65: rounding is an
offset inwards and back). In the rim band the highest of them has its centre on the outline offset
inwards by the radius; how high it lies there follows from its touching point with the crown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from taccel_lab.cad.parts.pad_outline import PadOutline

_TOUCH_ROUNDS = 12
_SLIDE_ROUNDS = 5

Field = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class FilletArc:
    """The arcs along which a ball of one radius touches the body, one for each outline point."""

    radius_mm: float
    centers_mm: np.ndarray
    """Centre of the ball, shape [n, 3]."""
    to_wall: np.ndarray
    """Unit direction in which it touches the wall, shape [n, 3]."""
    to_crown: np.ndarray
    """Unit direction in which it touches the crown, shape [n, 3]."""

    @property
    def turns_rad(self) -> np.ndarray:
        """Angle of each arc, shape [n]."""
        return np.arccos(np.clip((self.to_wall * self.to_crown).sum(axis=1), -1, 1))

    def points_mm(self, fraction: float) -> np.ndarray:
        """Points at a fraction of the arcs' angle from the wall (0) to the crown (1), [n, 3]."""
        turn = self.turns_rad[:, None]
        mixed = np.sin((1 - fraction) * turn) * self.to_wall
        mixed = (mixed + np.sin(fraction * turn) * self.to_crown) / np.sin(turn)
        return self.centers_mm + self.radius_mm * mixed


def fillet_arc(
    outline: PadOutline, radius_mm: float, crown_mm: Field, slope: Field, edge_mm: np.ndarray
) -> FilletArc:
    """Arcs of the fillet at points on the outline [mm], shape [n, 2].

    Both touching directions are perpendicular to the path of the ball's centre, so that the arc
    between them lies on the fillet.
    """
    normal = outline.outward_normal(edge_mm)
    center = edge_mm - radius_mm * normal
    z, _, arm = _ball_height_mm(radius_mm, crown_mm, slope, center)
    up = np.sqrt(radius_mm**2 - (arm**2).sum(axis=-1))
    return FilletArc(
        radius_mm,
        np.concatenate([center, z[:, None]], axis=1),
        np.concatenate([normal, np.zeros((len(normal), 1))], axis=1),
        np.concatenate([arm, up[:, None]], axis=1) / radius_mm,
    )


def fillet_height_mm(
    outline: PadOutline, radius_mm: float, crown_mm: Field, slope: Field, xy_mm: np.ndarray
) -> np.ndarray:
    """Height of the filleted top [mm], shape [...]; xy inside the outline [mm], shape [..., 2].

    ``crown_mm`` gives heights without the rim, shape [...], ``slope`` their gradient [..., 2]. The
    radius is less than the outline's radii.
    """
    xy = np.asarray(xy_mm, dtype=np.float64)
    height = np.array(crown_mm(xy), dtype=np.float64)
    near = outline.inside_distance_mm(xy) < radius_mm
    if not near.any():
        return height
    p = xy[near]
    # A ball that touches the crown over p and fits inside the wall leaves p as it is.
    g = slope(p)
    center = p + radius_mm * g / np.sqrt(1 + (g**2).sum(axis=-1, keepdims=True))
    cut = outline.inside_distance_mm(center) < radius_mm
    heights = height[near]
    heights[cut] = _envelope_mm(outline.inset(radius_mm), radius_mm, crown_mm, slope, p[cut])
    height[near] = heights
    return height


def _envelope_mm(
    spine: PadOutline, radius_mm: float, crown_mm: Field, slope: Field, p: np.ndarray
) -> np.ndarray:
    """Highest point over ``p`` of the balls whose centres lie over ``spine``, shape [n]."""
    center = _onto(spine, p)
    z, g, _ = _ball_height_mm(radius_mm, crown_mm, slope, center)
    for _ in range(_SLIDE_ROUNDS):
        # Newton's method along the spine for the stationary point of z + root; the curvature of
        # z itself is small beside that of the ball.
        arm = p - center
        _, normal, curvature = spine.nearest(center)
        tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
        bend = 1 + curvature * np.maximum((arm * normal).sum(axis=-1), 0)
        root = np.sqrt(np.maximum(radius_mm**2 - (arm**2).sum(axis=-1), 0))
        step = ((arm * tangent).sum(axis=-1) + (g * tangent).sum(axis=-1) * root) / bend
        center = _onto(spine, center + step[:, None] * tangent)
        z, g, _ = _ball_height_mm(radius_mm, crown_mm, slope, center)
    return z + np.sqrt(np.maximum(radius_mm**2 - ((p - center) ** 2).sum(axis=-1), 0))


def _onto(spine: PadOutline, xy: np.ndarray) -> np.ndarray:
    """Nearest points of the spine."""
    distance, normal, _ = spine.nearest(xy)
    return xy + distance[:, None] * normal


def _ball_height_mm(
    radius_mm: float, crown_mm: Field, slope: Field, center: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height of the ball's centre under the crown [n], its gradient [n, 2] and the way from the
    centre to the touching point in plan [n, 2].

    The gradient is that of the crown at the touching point (envelope theorem).
    """
    arm = np.zeros_like(center)
    g = arm
    for _ in range(_TOUCH_ROUNDS):
        g = slope(center + arm)
        arm = -radius_mm * g / np.sqrt(1 + (g**2).sum(axis=-1, keepdims=True))
    return crown_mm(center + arm) - np.sqrt(radius_mm**2 - (arm**2).sum(axis=-1)), g, arm
