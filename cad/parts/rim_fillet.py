# SPDX-License-Identifier: Apache-2.0
"""The rim as a rolling ball leaves it: the ball touches the wall and lies under the crown.

A fillet is the upper envelope of all balls of its radius that fit below the crown and inside the
wall (J. Rossignac, A. Requicha, Computers in Mechanical Engineering 3 (1984) 65: rounding is an
offset inwards and back). In the rim band the highest of them has its centre on the outline offset
inwards by the radius; how high it lies there follows from its touching point with the crown.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cad.parts.pad_outline import PadOutline

_TOUCH_ROUNDS = 12
_SLIDE_ROUNDS = 5

Field = Callable[[np.ndarray], np.ndarray]


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
    z, g = _ball_height_mm(radius_mm, crown_mm, slope, center)
    for _ in range(_SLIDE_ROUNDS):
        # Newton's method along the spine for the stationary point of z + root; the curvature of
        # z itself is small beside that of the ball.
        arm = p - center
        normal = spine.outward_normal(center)
        tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
        bend = 1 + spine.curvature_per_mm(center) * np.maximum((arm * normal).sum(axis=-1), 0)
        root = np.sqrt(np.maximum(radius_mm**2 - (arm**2).sum(axis=-1), 0))
        step = ((arm * tangent).sum(axis=-1) + (g * tangent).sum(axis=-1) * root) / bend
        center = _onto(spine, center + step[:, None] * tangent)
        z, g = _ball_height_mm(radius_mm, crown_mm, slope, center)
    return z + np.sqrt(np.maximum(radius_mm**2 - ((p - center) ** 2).sum(axis=-1), 0))


def _onto(spine: PadOutline, xy: np.ndarray) -> np.ndarray:
    """Nearest points of the spine."""
    return xy + spine.inside_distance_mm(xy)[:, None] * spine.outward_normal(xy)


def _ball_height_mm(
    radius_mm: float, crown_mm: Field, slope: Field, center: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Height of the ball's centre under the crown, shape [n], and its gradient, shape [n, 2].

    The gradient is that of the crown at the touching point (envelope theorem).
    """
    arm = np.zeros_like(center)
    g = arm
    for _ in range(_TOUCH_ROUNDS):
        g = slope(center + arm)
        arm = -radius_mm * g / np.sqrt(1 + (g**2).sum(axis=-1, keepdims=True))
    return crown_mm(center + arm) - np.sqrt(radius_mm**2 - (arm**2).sum(axis=-1)), g
